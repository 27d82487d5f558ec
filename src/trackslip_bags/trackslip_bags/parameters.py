# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""An estimator's parameters inside a bag: one std_msgs/String holding a ROS parameter file.

A bag then replays with the vehicle it was recorded on, wherever its files have gone.
"""

from collections.abc import Mapping
from typing import Any

from trackslip_bags.old_parameters import current_names
from trackslip_bags.reader import Bag, absolute
from trackslip_common.errors import InputError
from trackslip_common.parameters import flatten, from_flat
from trackslip_common.vehicle import VehicleParameters
from trackslip_common.vehicle_files import TOPIC, WithVehicle, names_vehicle, vehicle_of_text
from trackslip_common.yaml_text import parse_yaml

PARAMETERS_TOPIC = "slip_estimator/parameters"
PARAMETERS_TYPE = "std_msgs/msg/String"
_NODE = "slip_estimator"
_SPROCKETS = "sprockets"
_FROM_TF = ".mounting_from_tf"


def bag_parameters(bag: Bag) -> dict[str, Any]:
    """Dotted name → value of the parameters that a bag begins with; empty where it holds none.

    Later messages state what was changed while the estimator ran.

    Raises:
        InputError: what is on the topic is no parameter file.
    """
    return current_names(stated_parameters(bag, _NODE))


def bag_vehicle(bag: Bag) -> VehicleParameters | None:
    """The vehicle that a bag was recorded on, where it carries one.

    Raises:
        InputError: what it carries is none.
    """
    where = f"bag '{bag.path}'"
    for message in bag.messages([TOPIC]):
        if message.type_name != PARAMETERS_TYPE:
            break  # somebody else's topic of that name
        return vehicle_of_text(bag.deserialize(message.raw, message.type_name).data, f"{where}: {TOPIC}")
    values = bag_parameters(bag)
    if not names_vehicle(values):
        return None
    own = {name: value for name, value in values.items() if name.startswith(f"{TOPIC}.")}
    return from_flat(WithVehicle, own, where).vehicle


def namespaces(bag: Bag) -> list[str]:
    """Of the machines in a bag, '' for one that has none: where sprockets are, or what states a vehicle.

    A bag of neither is one of a machine without a namespace.
    """
    ends = [f"/{name}" for name in (TOPIC, PARAMETERS_TOPIC, _SPROCKETS)]
    names = [absolute(name) if "/" not in name else name for name in bag.topics]
    within = {name.removesuffix(end) for name in names for end in ends if name.endswith(end)}
    return sorted({name.strip("/") for name in within if not name or name.startswith("/")}) or [""]


def stated_parameters(bag: Bag, node: str) -> dict[str, Any]:
    """The same by the names that they had when it was recorded.

    How an IMU is mounted may have been found only later, from /tf_static; nothing was used of it before.
    """
    found: dict[str, Any] = {}
    for message in bag.messages([f"{node}/parameters"]):
        content = bag.deserialize(message.raw, message.type_name)
        values = flatten(_read(bag, content, node)["ros__parameters"])
        found = found or values
        mountings = mounting_names(found)
        if not mountings:
            return found
        found |= {name: values[name] for name in mountings & values.keys()}
    return found


def mounting_names(values: Mapping[str, Any]) -> set[str]:
    """Of the parameters that /tf_static may give later than the others, by what these are."""
    by_tf = [
        name.removesuffix(_FROM_TF) for name, value in values.items() if name.endswith(_FROM_TF) and value
    ]
    return {f"{source}.mounting_{axis}" for source in by_tf for axis in ("roll", "pitch", "yaw")}


def bag_learned(bag: Bag) -> Any:
    """What the estimator had learned before the bag begins, as it stands beside the parameters; else None.

    Raises:
        InputError: what is on the topic is no parameter file.
    """
    for message in bag.messages([f"{_NODE}/parameters"]):
        return read_learned(bag, bag.deserialize(message.raw, message.type_name))
    return None


def read_parameters(bag: Bag, content: Any) -> dict[str, Any]:
    """Dotted name → value of one such message (std_msgs/String).

    Raises:
        InputError: it is no parameter file.
    """
    return current_names(flatten(_read(bag, content, _NODE)["ros__parameters"]))


def read_learned(bag: Bag, content: Any) -> Any:
    """What an estimator had learned before its run, by one such message; None where it states nothing.

    Raises:
        InputError: it is no parameter file.
    """
    return _read(bag, content, _NODE).get("learned")


def _read(bag: Bag, content: Any, node: str) -> Mapping[str, Any]:
    """All that such a message has of the node."""
    try:
        found = parse_yaml(content.data, f"{node}/parameters")[node]
        if isinstance(found, Mapping) and isinstance(found["ros__parameters"], Mapping):
            return found
        raise TypeError(node)
    except (InputError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"bag '{bag.path}': {node}/parameters holds no parameters of {node}") from error
