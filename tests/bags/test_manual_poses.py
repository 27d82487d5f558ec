# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Selection of the topic of a bag with manually set poses."""

from pathlib import Path

import pytest
from fixtures.made_bags import write_messages

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.manual_poses import input_names
from trackslip_bags.messages import make, serialize
from trackslip_bags.playback import played_messages, played_topics
from trackslip_bags.reader import open_bag
from trackslip_bags.writer import BagWriter

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
SET_POSE, REPEATED = "/slip_estimator/set_pose", "/slip_estimator/pose_set"


@pytest.fixture(params=[(SET_POSE,), (SET_POSE, REPEATED), (REPEATED,)], ids=len)
def path(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    raw = serialize(make(POSE))
    return write_messages(tmp_path / "bag", ((topic, POSE, k, raw) for k, topic in enumerate(request.param)))


def test_each_set_pose_is_read_and_played_once(path: Path) -> None:
    with open_bag(path) as bag:
        assert list(input_names(bag).values()) == ["slip_estimator/set_pose"]
        topics = played_topics(bag, InputFilters(), ())
        assert topics == {SET_POSE: POSE}
        assert [message.topic for message in played_messages(bag, InputFilters(), topics)] == [SET_POSE]


def test_set_poses_are_read_where_the_repeat_topic_is_empty(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic(REPEATED, POSE, [])
        bag.write(SET_POSE, POSE, serialize(make(POSE)), 1)
    with open_bag(tmp_path / "bag") as opened:
        assert input_names(opened)[SET_POSE] == "slip_estimator/set_pose"
