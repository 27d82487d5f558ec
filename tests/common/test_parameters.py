# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters: each error is one line with the name, the value and the accepted range."""

import math
from array import array
from dataclasses import FrozenInstanceError, dataclass
from typing import Any

import pytest

from trackslip_common.errors import InputError
from trackslip_common.parameters import Parameters, flat_fields, flatten, from_flat, parameter, to_flat
from trackslip_common.yaml_text import parse_yaml


@dataclass(frozen=True, kw_only=True)
class Wheel(Parameters):
    """A nested group."""

    radius: float = parameter("how large", unit="m", gt=0.0, lt=2.0)
    colour: str = parameter("paint", choices=("red", "blue"))


@dataclass(frozen=True, kw_only=True)
class Cart(Parameters):
    """One parameter of each kind."""

    wheel: Wheel
    name: str = parameter("what it is called")
    seats: int = parameter("how many", ge=1, le=4)
    mass: float = parameter("how heavy", unit="kg", ge=0.0)
    drift: float = parameter("anything finite", unit="m/s")
    open: bool = parameter("whether it has no roof")
    gears: tuple[float, ...] = parameter("ratios", gt=0.0)
    doors: tuple[str, ...] = parameter("their names")


GOOD: dict[str, Any] = {
    "wheel.radius": 0.5,
    "wheel.colour": "red",
    "name": "one",
    "seats": 2,
    "mass": 0.0,
    "drift": -1.5,
    "open": True,
    "gears": [1.0, 2.5],
    "doors": [],
}


def cart(**changes: Any) -> Cart:
    """The valid cart with dotted names changed; `__` stands for the dot."""
    return from_flat(Cart, GOOD | {k.replace("__", "."): v for k, v in changes.items()}, "cart")


def refusal(**changes: Any) -> str:
    with pytest.raises(InputError) as caught:
        cart(**changes)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_flat_names_and_back_again() -> None:
    made = cart()
    assert made.wheel == Wheel(radius=0.5, colour="red")
    assert made.gears == (1.0, 2.5)
    assert to_flat(made) == GOOD
    assert from_flat(Cart, to_flat(made), "again") == made
    fields = {name: (kind, spec.unit) for name, kind, spec in flat_fields(Cart)}
    assert list(fields) == list(to_flat(made))
    assert (fields["wheel.radius"], fields["seats"]) == ((float, "m"), (int, ""))


def test_nested_mappings_flatten_to_dotted_names() -> None:
    assert flatten({"a": {"b": {"c": 1}, "d": [2]}, "e": None}) == {"a.b.c": 1, "a.d": [2], "e": None}


def test_integers_are_accepted_as_floats() -> None:
    made = cart(mass=3, gears=[1, 2])
    assert cart(gears=array("d", (1.0, 2.0))).gears == (1.0, 2.0)  # as given by ROS
    assert (type(made.mass), made.mass) == (float, 3.0)
    assert [type(gear) for gear in made.gears] == [float, float]


@pytest.mark.parametrize(
    ("changes", "thing", "value", "accepted"),
    [
        ({"wheel__radius": 0.0}, "cart: wheel.radius", "0.0", "> 0 and < 2 m"),
        ({"wheel__radius": "wide"}, "cart: wheel.radius", "'wide'", "> 0 and < 2 m"),
        ({"wheel__colour": "green"}, "cart: wheel.colour", "'green'", "one of red, blue"),
        ({"seats": 0}, "cart: seats", "0", ">= 1 and <= 4"),
        ({"seats": 2.0}, "cart: seats", "2.0", "whole number"),
        ({"seats": True}, "cart: seats", "True", "whole number"),
        ({"mass": -1e-9}, "cart: mass", "-1e-09", ">= 0 kg"),
        ({"mass": False}, "cart: mass", "False", "number"),
        ({"mass": None}, "cart: mass", "None", ">= 0 kg"),
        ({"drift": math.nan}, "cart: drift", "nan", "finite m/s"),
        ({"drift": -math.inf}, "cart: drift", "-inf", "finite m/s"),
        ({"drift": 10**400}, "cart: drift", "1000", "finite m/s"),
        ({"open": 1}, "cart: open", "1", "true or false"),
        ({"name": 7}, "cart: name", "7", "text"),
        ({"name": "a\nb", "doors": 3}, "cart: doors", "3", "list of text"),
        ({"doors": ["left", None]}, "cart: doors[1]", "None", "text"),
        ({"gears": 1.0}, "cart: gears", "1.0", "list of a number"),
        ({"gears": "12"}, "cart: gears", "'12'", "list of a number"),
        ({"gears": [1.0, 0.0]}, "cart: gears[1]", "0.0", "> 0"),
        ({"gears": [True]}, "cart: gears[0]", "True", "> 0"),
    ],
)
def test_a_bad_value_is_refused_by_name_value_and_range(
    changes: dict[str, Any], thing: str, value: str, accepted: str
) -> None:
    message = refusal(**changes)
    assert message.startswith(f"{thing}: {value}")
    assert accepted in message.removeprefix(f"{thing}: {value}")
    assert ("finite" in message) == ("finite" in accepted)  # no range of texts and flags


@pytest.mark.parametrize("value", [1e308, -1e160, 1e31])
def test_number_whose_square_or_inverse_overflows_is_refused(value: float) -> None:
    """For example a standard deviation of 1e308 or 1e-308; a coordinate may be arbitrarily small."""
    assert refusal(drift=value).startswith(f"cart: drift: {value!r} is beyond any physical value; accepted: ")
    small = 1.0 / abs(value)
    assert f"gears[0]: {small!r} is beyond any physical value" in refusal(gears=[small])
    assert cart(drift=-small).drift == -small


def test_inclusive_limits_are_accepted() -> None:
    assert (cart(seats=1).seats, cart(seats=4).seats, cart(wheel__radius=1.999).wheel.radius) == (1, 4, 1.999)


def test_unknown_names_are_refused_with_those_known() -> None:
    message = refusal(wheel__depth=1.0)
    assert message == "cart: unknown parameter 'wheel.depth'; accepted: wheel.radius, wheel.colour"
    assert refusal(tyre=1.0).endswith("accepted: wheel, name, seats, mass, drift, open, gears, doors")


@pytest.mark.parametrize(
    ("name", "meant"), [("wheel.radios", "wheel.radius"), ("whel.radius", "wheel"), ("gear", "gears")]
)
def test_a_name_that_is_almost_right_is_recognised(name: str, meant: str) -> None:
    assert refusal(**{name: 1.0}) == f"cart: unknown parameter '{name}', did you mean '{meant}'?"


@pytest.mark.parametrize("name", ["wheel", "name.first"])
def test_value_for_a_group_and_group_for_a_value_are_refused(name: str) -> None:
    assert refusal(**{name: 1.0}).startswith(f"cart: unknown parameter '{name}'")


@pytest.mark.parametrize("name", GOOD)
def test_missing_names_are_refused_with_their_meaning(name: str) -> None:
    with pytest.raises(InputError, match=f"^cart: parameter '{name}' is missing \\(.+\\)$"):
        from_flat(Cart, {k: v for k, v in GOOD.items() if k != name}, "cart")


def test_construction_checks_as_well() -> None:
    with pytest.raises(InputError, match=r"^Wheel\.radius: -1\.0 is out of range; accepted: > 0 and < 2 m$"):
        Wheel(radius=-1.0, colour="red")


def test_parameters_cannot_be_changed() -> None:
    with pytest.raises(FrozenInstanceError):
        cart().seats = 3  # type: ignore[misc]


def test_parity_n_without_quotes_is_text():
    """YAML 1.1 reads n, no and off as booleans, in rcl's reader as in PyYAML."""

    @dataclass(frozen=True, kw_only=True)
    class Line(Parameters):
        parity: str = parameter("of the line", choices=("N", "E", "O"))

    assert from_flat(Line, parse_yaml("parity: N", "text"), "line").parity == "N"
    assert from_flat(Line, {"parity": False}, "line").parity == "N"
    with pytest.raises(InputError, match="True is not text; accepted: one of N, E, O"):
        from_flat(Line, {"parity": True}, "line")
