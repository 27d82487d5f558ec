# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Vehicles by name, from files and from text, and as parameters of a node."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import yaml

from trackslip_common.config_files import config_directory, read_yaml, unflatten
from trackslip_common.errors import InputError, suggestion
from trackslip_common.parameters import Parameters, flatten, from_flat, to_flat
from trackslip_common.vehicle import VehicleParameters
from trackslip_common.vehicle_checks import check_consistency
from trackslip_common.yaml_text import parse_mapping

DEFAULT_VEHICLE = "pc05"  # if no vehicle is named
DEFAULT_VEHICLE_NOTE = f"vehicle: {DEFAULT_VEHICLE} is assumed: the bag names none (--vehicle does)"
TOPIC = "vehicle"  # latched topic with the text of a vehicle; also the parameter that names one
_GROUP = f"{TOPIC}."
_NAME = "name"  # in a vehicle file: name of the machine; by default that of the file
_BASE = "base"  # in a vehicle file: another vehicle, whose numbers are the defaults


@dataclass(frozen=True, kw_only=True)
class ParametersWithVehicle(Parameters):
    """Base of parameters with a vehicle: ``vehicle`` names its file, ``vehicle.<group>`` are its numbers."""

    EXTRA_NAMES: ClassVar[frozenset[str]] = frozenset({TOPIC})

    vehicle: VehicleParameters

    def __post_init__(self) -> None:
        """Check each parameter, and the vehicle as a whole."""
        super().__post_init__()
        check_consistency(self.vehicle, TOPIC)

    @classmethod
    def overlay(cls, below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
        """Values with others over them; a named vehicle replaces another one completely.

        Raises:
            InputError: there is no such vehicle.
        """
        above = _resolve_vehicle(above)
        if f"{_GROUP}name" in above:
            below = {name: value for name, value in below.items() if not name.startswith(_GROUP)}
        elif f"{_GROUP}name" not in below:
            below = {**below, **_resolve_vehicle({TOPIC: DEFAULT_VEHICLE})}
        return super().overlay(below, above)


def has_vehicle_name(values: Mapping[str, Any]) -> bool:
    """Whether these parameters name a vehicle."""
    return TOPIC in values or f"{_GROUP}name" in values


def vehicle_names() -> list[str]:
    """Names of the files in ``config/vehicles/``."""
    return sorted(path.stem for path in (config_directory() / "vehicles").glob("*.yaml"))


def load_vehicle(name: str = DEFAULT_VEHICLE) -> VehicleParameters:
    """A vehicle by its name in ``config/vehicles/``, or from a file.

    Raises:
        InputError: there is no such vehicle, or a value in its file is rejected.
    """
    path = _find_file(name)
    return make_vehicle(path.stem, _read_numbers(path), str(path))


def parse_vehicle(text: str, where: str) -> VehicleParameters:
    """A vehicle from the text of the topic ``vehicle``.

    Raises:
        InputError: the text is no vehicle.
    """
    return make_vehicle("unnamed", flatten(parse_mapping(text, where)), where)


def make_vehicle(name: str, numbers: Mapping[str, Any], where: str) -> VehicleParameters:
    """A vehicle from dotted names; ``name`` is used if they contain no name.

    Raises:
        InputError: a name or a value is rejected, or values are inconsistent.
    """
    vehicle = from_flat(VehicleParameters, {_NAME: name, **numbers}, where)
    check_consistency(vehicle, where)
    return vehicle


def vehicle_text(vehicle: VehicleParameters) -> str:
    """Text of a file for the vehicle, without comments."""
    text: str = yaml.safe_dump(unflatten(to_flat(vehicle)), sort_keys=False)
    return text


def vehicle_layer(vehicle: VehicleParameters) -> dict[str, Any]:
    """All numbers of a vehicle as parameters of a node, by dotted name."""
    return to_flat(vehicle, _GROUP)


def _read_numbers(path: Path) -> dict[str, Any]:
    """Values of a vehicle file by dotted name, over those of its base if it names one."""
    values = flatten(read_yaml(path))
    base = values.pop(_BASE, None)
    if base is None:
        return values
    base_values = flatten(read_yaml(_find_file(str(base))))
    if _BASE in base_values:
        raise InputError(f"{path}: {_BASE}: '{base}' has one too; accepted: a vehicle without")
    base_values.pop(_NAME, None)  # a variant has its own name, or that of its file
    return {**base_values, **values}


def _resolve_vehicle(values: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters with the numbers of the vehicle that they name, overridden by those given directly."""
    if TOPIC not in values:
        return dict(values)
    rest = {name: value for name, value in values.items() if name != TOPIC}
    name = values[TOPIC]
    if not isinstance(name, str):
        raise InputError(f"{TOPIC}: {name!r} is not text; accepted: {', '.join(vehicle_names())}, or a file")
    return {**vehicle_layer(load_vehicle(name)), **rest}


def _find_file(name: str) -> Path:
    for candidate in (config_directory() / "vehicles" / f"{name}.yaml", Path(name)):
        if candidate.is_file():
            return candidate
    hint = suggestion(name, vehicle_names(), ", or a YAML file")
    raise InputError(f"vehicle '{name}': no such vehicle or file{hint}")
