# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Drafts the vehicle file of a new machine from known numbers; guesses the others from its mass.

Tracked excavators are nearly similar: a length of a machine of mass m is c m^(1/3). Each factor c lies
between those of ``pc05`` (1.3 t) and ``excavator_20t``. The stated standard deviation covers both with a
margin.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from trackslip_common.errors import InputError
from trackslip_common.parameter_spec import Spec, check_value
from trackslip_common.parameters import flat_fields
from trackslip_common.vehicle import VehicleParameters
from trackslip_common.vehicle_files import make_vehicle

MASS = "mass.mass"
RADIUS = "kinematics.rolling_radius"
ANTENNA = "sensors.antenna"

MEASURING_METHODS = {  # how to measure a guessed number
    RADIUS: "20 m of hard ground over the sprocket's angle, rad",
    "kinematics.tread": "tape: outer edge of one track to the inner edge of the other",
    "kinematics.contact_length": "tape: from below the sprocket's centre to below the idler's",
    MASS: "type plate, or weighbridge",
    "mass.track_width": "tape: of a shoe",
    "mass.yaw_inertia": "hardly known; ± 30 % will do",
    f"{ANTENNA}.x": "tape, or trackslip check on a drive with turns",
    f"{ANTENNA}.y": "tape, or trackslip check on a drive with turns",
    f"{ANTENNA}.z": "tape, from the ground",
}


class _Length(NamedTuple):
    factor: float  # c, m/kg^(1/3)
    share: float  # relative standard deviation of the length among machines


_LENGTHS = {
    RADIUS: _Length(0.0135, 0.15),
    "kinematics.tread": _Length(0.077, 0.15),
    "kinematics.contact_length": _Length(0.121, 0.1),
    "mass.track_width": _Length(0.0215, 0.15),
    f"{ANTENNA}.z": _Length(0.12, 0.3),  # cab roof
}
_LARGEST_RATIO = 4.0  # of a length to that guessed from the mass: robots are wider than excavators
_CENTRE_POSITION = dict.fromkeys((f"{ANTENNA}.x", f"{ANTENNA}.y"), 0.0)  # in the middle between the tracks
# Size of a block with the machine's yaw inertia, over contact length and tread.
_BLOCK = (1.3, 1.2)
REQUIRED_NUMBERS = (MASS, RADIUS, "kinematics.tread", "kinematics.contact_length")
_HYDRAULICS = "hydraulics."
# An error of the rolling radius acts like a slip common to both tracks.
_PRIORS = """\
# Of {0}, for --params and params_file: its rolling radius is guessed.
slip_estimator:
  ros__parameters:
    turning:
      initial_common_slip_stddev: {1:g}
"""


@dataclass(frozen=True)
class Draft:
    """A vehicle with the numbers that were guessed."""

    vehicle: VehicleParameters
    values: Mapping[str, float]  # by dotted name
    guessed: Mapping[str, float]  # dotted name → relative standard deviation; 0: unknown
    missing: tuple[str, ...]  # omitted parts, as sentences

    @property
    def implausible_lengths(self) -> tuple[str, ...]:
        """Sentences on stated lengths that no machine of the stated mass has, as with a mass in tons."""
        if MASS not in self.values or MASS in self.guessed:
            return ()
        mass = self.values[MASS]
        return tuple(
            f"{name} {stated:g} m with {mass:g} kg; usual: {_round_guess(usual):g} m, or {heavier:g} kg"
            for name, stated in self.values.items()
            if name in _LENGTHS and name not in self.guessed
            for usual in (_LENGTHS[name].factor * mass ** (1 / 3),)
            for heavier in (_round_guess(mass * (stated / usual) ** 3),)
            if not 1.0 / _LARGEST_RATIO < stated / usual < _LARGEST_RATIO
        )

    @property
    def files(self) -> dict[str, str]:
        """File name → text: the vehicle, then estimator parameters that a guessed rolling radius requires."""
        name, share = self.vehicle.name, self.guessed.get(RADIUS)
        texts = {f"{name}.yaml": self._vehicle_text()}
        return texts | ({f"{name}_estimator.yaml": _PRIORS.format(name, share)} if share else {})

    def _vehicle_text(self) -> str:
        """The vehicle in the format of ``config/vehicles``."""
        lines = [
            f"# {self.vehicle.name}, by trackslip vehicle new. Measure what is guessed, the first lines",
            "# first; config/vehicles/excavator_20t.yaml says how, and which groups may be added.",
            f"name: {self.vehicle.name}",
        ]
        open_groups: list[str] = []
        for name, spec in _specs():
            if name in self.values:
                *groups, last = name.split(".")
                depth = next(
                    (k for k, (a, b) in enumerate(zip(groups, open_groups, strict=False)) if a != b),
                    min(len(groups), len(open_groups)),
                )
                lines += [f"{'  ' * k}{groups[k]}:" for k in range(depth, len(groups))]
                open_groups = groups
                value = f"{'  ' * len(groups)}{last}: {self.values[name]:.6g}"
                lines.append(f"{value:<30} # {self._comment(name, spec)}")
        return "\n".join(lines) + "\n"

    def _comment(self, name: str, spec: Spec) -> str:
        about = f"{spec.unit}, {spec.description}" if spec.unit else spec.description
        if name not in self.guessed:
            return about
        share = self.guessed[name]
        return f"{about}; guessed{f', ± {100 * share:.0f} %' if share else ''}: {MEASURING_METHODS[name]}"


def draft_vehicle(name: str, known: Mapping[str, float]) -> Draft:
    """Draft a vehicle from known numbers, by dotted name of a vehicle file.

    Raises:
        InputError: too few numbers are known, a number is rejected, or numbers contradict each other.
    """
    for one, spec in _specs():
        if one in known:
            check_value(f"vehicle '{name}': {one}", known[one], float, spec)
    values, guessed = dict(known), dict[str, float]()
    lacking = [one for one in REQUIRED_NUMBERS if one not in values]
    if MASS in lacking and len(lacking) > 1:
        options = ", ".join(f"--{_option_name(one)}" for one in lacking[1:])
        raise InputError(
            f"vehicle new: {', '.join(lacking[1:])} cannot be guessed without a mass; "
            f"accepted: --mass, or all of {options}"
        )
    for one, length in _LENGTHS.items() if MASS in values else ():
        if one not in values:
            values[one], guessed[one] = _round_guess(length.factor * values[MASS] ** (1 / 3)), length.share
    for one, value in _CENTRE_POSITION.items():
        if one not in values and f"{ANTENNA}.z" in values:
            values[one], guessed[one] = value, 0.0
    if MASS in values and "mass.yaw_inertia" not in values:
        sides = (values["kinematics.contact_length"] * _BLOCK[0], values["kinematics.tread"] * _BLOCK[1])
        inertia = values[MASS] * sum(side * side for side in sides) / 12.0
        values["mass.yaw_inertia"], guessed["mass.yaw_inertia"] = _round_guess(inertia), 0.3
    missing = tuple(_omitted_parts(values))
    complete = {one: value for one, value in values.items() if _is_group_complete(one, values)}
    vehicle = make_vehicle(name, complete, f"vehicle '{name}'")
    return Draft(vehicle, complete, guessed, missing)


def _omitted_parts(values: Mapping[str, float]) -> Iterator[str]:
    """Sentences on the omitted parts of the file, with the options that would provide them."""
    hydraulics = [name for name, _ in _specs() if name.startswith(_HYDRAULICS) and name not in values]
    if hydraulics:
        options = " ".join(f"--{_option_name(name)}" for name in hydraulics)
        yield f"no forces and no soil without hydraulics: {options}"
    if MASS not in values:
        yield "no forces and no soil without --mass"
    if f"{ANTENNA}.z" not in values:
        yield "no position by a receiver without its antenna: --antenna X Y Z"


def _is_group_complete(name: str, values: Mapping[str, float]) -> bool:
    """Whether all numbers in the group of this one are known; incomplete groups are omitted."""
    group = name.rpartition(".")[0] + "."
    return all(one in values for one, _ in _specs() if one.startswith(group) and "." not in one[len(group) :])


def number_options() -> Iterator[tuple[str, str, Spec]]:
    """(option, dotted name, spec) of each number with an option of its own."""
    for name, spec in _specs():
        if name.split(".")[0] in ("kinematics", "mass", "hydraulics") and name.count(".") == 1:
            yield _option_name(name), name, spec


def _option_name(name: str) -> str:
    return name.rpartition(".")[2].replace("_", "-")


def _specs() -> Iterator[tuple[str, Spec]]:
    return ((name, spec) for name, kind, spec in flat_fields(VehicleParameters) if kind is float)


def _round_guess(value: float) -> float:
    """Rounded to two digits, the precision of a guess."""
    return float(f"{value:.2g}")
