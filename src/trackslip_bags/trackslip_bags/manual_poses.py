# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Manually set poses, from the topic on which the estimator repeats them, if the bag has it.

A recorder may not discover a node that sets a pose and ends; the estimator runs all the time.
"""

from trackslip_bags.input_filters import relative_name
from trackslip_bags.reader import Bag
from trackslip_estimation.slip.measurements import POSE_SET, SET_POSE


def input_names(bag: Bag) -> dict[str, str]:
    """Topic of the bag → its relative name as an input; the repeated poses replace ``SET_POSE``."""
    names = {topic: relative_name(topic) for topic in bag.topics}
    repeated = {topic: SET_POSE for topic, name in names.items() if name == POSE_SET}
    if not any(bag.topics[topic].count for topic in repeated):
        return names
    return {topic: name for topic, name in names.items() if name != SET_POSE} | repeated
