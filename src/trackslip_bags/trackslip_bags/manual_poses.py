# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Poses that somebody set: from the topic on which the estimator repeats them, where a bag has it.

Who sets a pose and is gone may never have been found by the recorder; the estimator is there all the time.
"""

from trackslip_bags.input_filters import relative
from trackslip_bags.reader import Bag
from trackslip_estimation.slip.measurements import POSE_SET, SET_POSE


def input_names(bag: Bag) -> dict[str, str]:
    """Topic of the bag → its relative name as an input; ``SET_POSE`` stands for what was repeated."""
    names = {topic: relative(topic) for topic in bag.topics}
    repeated = {topic: SET_POSE for topic, name in names.items() if name == POSE_SET}
    if not any(bag.topics[topic].count for topic in repeated):
        return names
    return {topic: name for topic, name in names.items() if name != SET_POSE} | repeated
