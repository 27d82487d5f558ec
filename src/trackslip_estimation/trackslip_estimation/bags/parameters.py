# SPDX-License-Identifier: Apache-2.0
"""The estimator's parameters inside a bag: one std_msgs/String holding a ROS parameter file.

A bag then replays with the vehicle it was recorded on, wherever its files have gone.
"""

from collections.abc import Mapping
from typing import Any

import yaml

from trackslip_common.errors import InputError
from trackslip_common.parameters import flatten
from trackslip_estimation.bags.reader import Bag

PARAMETERS_TOPIC = "slip_estimator/parameters"
PARAMETERS_TYPE = "std_msgs/msg/String"
_NODE = "slip_estimator"


def parameters_text(parameters: Mapping[str, Any]) -> str:
    """The YAML text to put on ``PARAMETERS_TOPIC``; nested or dotted names, as a parameter file has them."""
    text: str = yaml.safe_dump({_NODE: {"ros__parameters": dict(parameters)}}, sort_keys=False)
    return text


def bag_parameters(bag: Bag) -> dict[str, Any]:
    """Dotted name → value of the parameters that a bag begins with; empty where it holds none.

    Later messages tell what was changed while the estimator ran.

    Raises:
        InputError: what is on the topic is no parameter file.
    """
    for message in bag.messages([PARAMETERS_TOPIC]):
        return read_parameters(bag, bag.deserialize(message.raw, message.type_name).data)
    return {}


def read_parameters(bag: Bag, text: str) -> dict[str, Any]:
    """Dotted name → value of one such message.

    Raises:
        InputError: it is no parameter file.
    """
    try:
        return flatten(yaml.safe_load(text)[_NODE]["ros__parameters"])
    except (yaml.YAMLError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"bag '{bag.path}': {PARAMETERS_TOPIC} holds no parameters of {_NODE}") from error
