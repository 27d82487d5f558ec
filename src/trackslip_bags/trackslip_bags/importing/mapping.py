# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The mapping file of ``trackslip import``: what columns and topics contain. docs/import.md has all keys.

time: {column: t, unit: s}             # of CSV logs
topics:
  sprockets:                           # columns of a CSV log …
    left_velocity: {column: wl, unit: deg/s, scale: -1.0}
    right_velocity: {column: wr, unit: deg/s}
  imu/data_raw: {from: /imu/data}      # … or a topic of a bag
  reference_pose: {x: …, y: …, yaw: …, stddev: {x: 0.02, y: 0.02, yaw: 0.01}}
vehicle: warthog                       # a name of config/vehicles, a file, or {kinematics: {…}}
parameters: {…}                        # of slip_estimator; both are kept in the bag
can: {dbc: …, roles: …}                # logs of a bus, and
gnss: {…}                              # of a receiver, alone or beside topics (``recorded_devices``)
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trackslip_bags.importing.columns import FIRST
from trackslip_bags.importing.mapping_topics import FROM, BagTopic, CsvTopic, Geometry, read_topic
from trackslip_bags.importing.recorded_devices import CanSection, GnssSection, read_can, read_gnss
from trackslip_bags.importing.roles import ROLE_OF_TOPIC
from trackslip_common.config_files import read_yaml
from trackslip_common.errors import InputError
from trackslip_common.parameters import flatten
from trackslip_common.vehicle import VehicleParameters
from trackslip_common.vehicle_files import load_vehicle, make_vehicle, vehicle_layer
from trackslip_common.yaml_tree import check_keys, nanoseconds, number, section, text
from trackslip_estimation.gnss.localizer import Datum
from trackslip_estimation.gnss.parameters import HIGHEST_LATITUDE
from trackslip_estimation.slip.parameters import load_slip_parameters

_CSV_KEYS = ("time", "received", "csv")  # keys for all topics of CSV logs
_DEVICE_KEYS = ("can", "gnss")  # sections for logs of a bus and of a receiver


@dataclass(frozen=True)
class LogMapping:
    """A whole mapping file."""

    path: Path
    start_ns: int
    datum: Datum | None  # None: the first position
    topics: Mapping[str, CsvTopic | BagTopic]
    vehicle: VehicleParameters | None
    parameters: Mapping[str, Any]
    can: CanSection | None = None
    gnss: GnssSection | None = None


def read_mapping(path: Path, vehicle: VehicleParameters | None = None) -> LogMapping:
    """Read a mapping file; ``vehicle`` replaces its own.

    Raises:
        InputError: it cannot be read, or a key, unit or value in it is not accepted.
    """
    tree = read_yaml(path)
    where = str(path)
    optional = (*_CSV_KEYS, *_DEVICE_KEYS, "start", "datum", "vehicle", "parameters")
    check_keys(where, tree, () if tree.keys() & set(_DEVICE_KEYS) else ("topics",), ("topics", *optional))
    sections = section(f"{where}: topics", tree.get("topics", {}))
    if not sections and not tree.keys() & set(_DEVICE_KEYS):
        raise InputError(f"{where}: topics is empty; accepted: {', '.join(ROLE_OF_TOPIC)}")
    parameters = section(f"{where}: parameters", tree.get("parameters", {}))
    if "vehicle" in parameters:
        raise InputError(f"{where}: parameters.vehicle; accepted: vehicle beside parameters")
    if vehicle is None and "vehicle" in tree:
        vehicle = _vehicle(path, tree["vehicle"])
    _check_parameters(path, parameters, vehicle)
    kinematics = None if vehicle is None else vehicle.kinematics
    geometry = None if kinematics is None else Geometry(kinematics.rolling_radius, kinematics.tread)
    common: dict[str, Any] = {name: tree[name] for name in _CSV_KEYS if name in tree}
    topics = {name: read_topic(where, name, topic, common, geometry) for name, topic in sections.items()}
    if len({isinstance(topic, BagTopic) for topic in topics.values()}) > 1:
        raise InputError(f"{where}: topics both with and without '{FROM}'; accepted: one log, a bag or CSV")
    if common and any(isinstance(topic, BagTopic) for topic in topics.values()):
        raise InputError(f"{where}: '{next(iter(common))}' is of CSV logs; accepted for a bag: {FROM} alone")
    return LogMapping(
        path=path,
        start_ns=nanoseconds(f"{where}: start", tree.get("start", 0.0)),
        datum=_datum(f"{where}: datum", tree.get("datum", FIRST)),
        topics=topics,
        vehicle=vehicle,
        parameters=parameters,
        can=read_can(path, tree["can"]) if "can" in tree else None,
        gnss=read_gnss(path, tree["gnss"]) if "gnss" in tree else None,
    )


def _vehicle(path: Path, value: Any) -> VehicleParameters:
    """Vehicle by its name, from a file, here or beside the mapping, or as stated in the mapping."""
    where = f"{path}: vehicle"
    if isinstance(value, Mapping):
        return make_vehicle(path.stem, flatten(value), where)
    name = text(where, value)
    beside = path.parent / name
    try:
        return load_vehicle(str(beside) if beside.is_file() else name)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _check_parameters(path: Path, parameters: Mapping[str, Any], vehicle: VehicleParameters | None) -> None:
    """Accept parameters of the slip estimator only."""
    machine = {} if vehicle is None else vehicle_layer(vehicle)
    try:
        load_slip_parameters(machine, flatten(parameters))
    except InputError as error:
        raise InputError(f"{path}: parameters: {error}") from error


def _datum(where: str, value: Any) -> Datum | None:
    if value == FIRST:
        return None
    tree = section(where, value)
    check_keys(where, tree, ("latitude", "longitude"), ("altitude",))
    latitude, longitude = (number(f"{where}.{name}", tree[name]) for name in ("latitude", "longitude"))
    if abs(latitude) > HIGHEST_LATITUDE or abs(longitude) > 180.0:
        limit = f"{HIGHEST_LATITUDE:g}"
        accepted = f"latitude in -{limit} … {limit}, longitude in -180 … 180 deg"
        raise InputError(f"{where}: {latitude:g}, {longitude:g} is out of range; accepted: {accepted}")
    return Datum(latitude, longitude, number(f"{where}.altitude", tree.get("altitude", 0.0)))
