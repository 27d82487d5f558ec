# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""An estimator's parameters in a bag: a std_msgs/String with a ROS parameter file.

A bag therefore replays with the vehicle of the recording, without the original files.
"""

from collections.abc import Mapping
from typing import Any

from trackslip_bags.reader import Bag
from trackslip_common.errors import InputError
from trackslip_common.parameters import flatten, from_flat
from trackslip_common.vehicle import VehicleParameters
from trackslip_common.vehicle_files import TOPIC, ParametersWithVehicle, has_vehicle_name, parse_vehicle
from trackslip_common.yaml_text import parse_yaml

PARAMETERS_TOPIC = "slip_estimator/parameters"
PARAMETERS_TYPE = "std_msgs/msg/String"
_NODE = "slip_estimator"
_FROM_TF = ".mounting_from_tf"


def bag_parameters(bag: Bag) -> dict[str, Any]:
    """Dotted name → value of the parameters at the start of a bag; empty if it has none.

    Later messages state changes during the run.

    Raises:
        InputError: the topic has no parameter file.
    """
    return stated_parameters(bag, _NODE)


def bag_vehicle(bag: Bag) -> VehicleParameters | None:
    """The vehicle of a bag; None if the bag has none.

    Raises:
        InputError: the bag's vehicle is invalid.
    """
    where = f"bag '{bag.path}'"
    for message in bag.messages([TOPIC]):
        if message.type_name != PARAMETERS_TYPE:
            break  # a foreign topic of that name
        return parse_vehicle(bag.deserialize(message.raw, message.type_name).data, f"{where}: {TOPIC}")
    values = bag_parameters(bag)
    if not has_vehicle_name(values):
        return None
    vehicle_values = {name: value for name, value in values.items() if name.startswith(f"{TOPIC}.")}
    return from_flat(ParametersWithVehicle, vehicle_values, where).vehicle


def stated_parameters(bag: Bag, node: str) -> dict[str, Any]:
    """Dotted name → value of a node's parameters at the start of a bag.

    The mounting of an IMU may come later, from /tf_static; the estimator does not use the IMU before.
    """
    parameters: dict[str, Any] = {}
    for message in bag.messages([f"{node}/parameters"]):
        content = bag.deserialize(message.raw, message.type_name)
        values = flatten(_read(bag, content, node)["ros__parameters"])
        parameters = parameters or values
        mountings = mounting_names(parameters)
        if not mountings:
            return parameters
        parameters |= {name: values[name] for name in mountings & values.keys()}
    return parameters


def mounting_names(values: Mapping[str, Any]) -> set[str]:
    """Names of the mounting parameters that /tf_static may set after the start."""
    sources = [
        name.removesuffix(_FROM_TF) for name, value in values.items() if name.endswith(_FROM_TF) and value
    ]
    return {f"{source}.mounting_{axis}" for source in sources for axis in ("roll", "pitch", "yaw")}


def bag_learned(bag: Bag) -> Any:
    """Learned values of the estimator at the start of the bag, from the parameter message; else None.

    Raises:
        InputError: the topic has no parameter file.
    """
    for message in bag.messages([f"{_NODE}/parameters"]):
        return read_learned(bag, bag.deserialize(message.raw, message.type_name))
    return None


def read_parameters(bag: Bag, content: Any) -> dict[str, Any]:
    """Dotted name → value of one parameter message (std_msgs/String).

    Raises:
        InputError: it is not a parameter file.
    """
    return flatten(_read(bag, content, _NODE)["ros__parameters"])


def read_learned(bag: Bag, content: Any) -> Any:
    """Learned values of an estimator before its run, from one parameter message; None without any.

    Raises:
        InputError: it is not a parameter file.
    """
    return _read(bag, content, _NODE).get("learned")


def _read(bag: Bag, content: Any, node: str) -> Mapping[str, Any]:
    """The node's entry of a parameter message."""
    try:
        entry = parse_yaml(content.data, f"{node}/parameters")[node]
        if isinstance(entry, Mapping) and isinstance(entry["ros__parameters"], Mapping):
            return entry
        raise TypeError(node)
    except (InputError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"bag '{bag.path}': {node}/parameters holds no parameters of {node}") from error
