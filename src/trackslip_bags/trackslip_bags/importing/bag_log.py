# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of other robots' bags by a mapping: ROS 2 (MCAP, SQLite) and ROS 1; with stamps and log times."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trackslip_bags.importing.bag_readings import (
    NO_JOINTS,
    OTHER_FRAME,
    READERS,
    columns_of,
    heading_columns,
    joint_columns,
    joint_names,
)
from trackslip_bags.importing.joints import PARTIAL, JointsByStamp
from trackslip_bags.importing.local import LocalFrame
from trackslip_bags.importing.mapping_topics import JOINT, NEEDS_GEOMETRY, SIDES, BagTopic
from trackslip_bags.importing.robot_bags import LoggedMessage, RobotLog, Ros1Bags, Ros2Bag
from trackslip_bags.importing.role_values import pose_covariance, values_of
from trackslip_bags.importing.roles import JOINTS, ROLES
from trackslip_bags.importing.samples import Samples, SelectedRows, Values
from trackslip_bags.importing.times import LIMIT_NS
from trackslip_bags.metadata import METADATA
from trackslip_bags.reader import absolute_name, open_bag
from trackslip_bags.sources import SUFFIXES, error_line
from trackslip_common.errors import InputError, did_you_mean, joined_names
from trackslip_common.make import stamp_ns_of

_ROS1 = (".bag", ".bag.active")


def is_bag(path: Path) -> bool:
    """Whether a path looks like a bag: a directory of one, or a file with a bag's name."""
    if path.is_dir():
        return (path / METADATA).exists() or any(file.name.endswith(SUFFIXES) for file in path.iterdir())
    return path.name.endswith((*_ROS1, *SUFFIXES))


def read_bag_log(
    paths: Sequence[Path], topics: Sequence[BagTopic], local: LocalFrame
) -> tuple[list[Samples], list[str]]:
    """Samples of each topic, and notes.

    Raises:
        InputError: the bag cannot be read or does not fit the mapping.
    """
    if all(path.name.endswith(_ROS1) and path.is_file() for path in paths):
        with Ros1Bags(paths) as ros1:
            return _read_samples(ros1, topics, local), []
    if len(paths) > 1:
        accepted = "one, or several .bag files of ROS 1 (a split recording of ROS 2: its directory)"
        raise InputError(f"{len(paths)} bags; accepted: {accepted}")
    with open_bag(paths[0]) as bag:
        return _read_samples(Ros2Bag(bag), topics, local), [f"damaged: {bag.damage}"] if bag.damage else []


def _read_samples(log: RobotLog, topics: Sequence[BagTopic], local: LocalFrame) -> list[Samples]:
    """Samples of each topic, by one pass over the bag."""
    types = log.types
    collectors = [_Collector(log, topic, _type_of(log, topic, types)) for topic in topics]
    by_source: dict[str, list[_Collector]] = {}
    for collector in collectors:
        by_source.setdefault(absolute_name(collector.topic.source), []).append(collector)
    for message in log.read(list(by_source)):
        for collector in by_source[message.topic]:
            collector.add(message)
    return [collector.samples(local) for collector in collectors]


def _type_of(log: RobotLog, topic: BagTopic, types: Mapping[str, str]) -> str:
    """The type of a topic; it must be one that its role accepts."""
    source = absolute_name(topic.source)
    if source not in types:
        like, there = did_you_mean(source, types), ", ".join(sorted(types)) or "nothing"
        raise InputError(f"{topic.where}.from: no topic '{source}' in {log.path}{like}; it holds: {there}")
    type_name = types[source]
    if (topic.role, type_name) not in READERS:
        accepted = ", ".join(name for role, name in READERS if role == topic.role)
        raise InputError(f"{topic.where}.from: {source} is a {type_name}; accepted: {accepted}")
    if topic.role == "sprockets" and type_name != JOINTS and topic.geometry is None:
        raise InputError(f"{topic.where}: {NEEDS_GEOMETRY}")
    return type_name


class _Collector:
    """Readings of one topic of the mapping."""

    def __init__(self, log: RobotLog, topic: BagTopic, type_name: str) -> None:
        self.topic, self._type_name, self._log = topic, type_name, log
        self._read_message = READERS[topic.role, type_name]
        self._readings: list[dict[str, Any]] = []
        self._times: list[tuple[int, int]] = []  # stamp, log time
        self._frames: list[str] = []
        self._left_out: Counter[str] = Counter()
        self._unused_joints: dict[str, None] = {}  # joints of unusable messages
        self._children: set[str] = set()  # frames of transforms
        self._joints = JointsByStamp(set(joint_names(topic) if type_name == JOINTS else ()))

    def add(self, message: LoggedMessage) -> None:
        """Add one message of the topic.

        Raises:
            InputError: its fields are not those of its type.
        """
        try:
            self._add_readings(message)
        except (AttributeError, LookupError, TypeError, ValueError, OverflowError) as error:
            text = (
                f"bag '{self._log.path}': bad {self._type_name} on {self.topic.source} ({error_line(error)})"
            )
            raise InputError(text) from error

    def _add_readings(self, message: LoggedMessage) -> None:
        content = self._joints.add(message.content) if self._type_name == JOINTS else message.content
        if content is None:
            self._unused_joints |= dict.fromkeys(message.content.name)
            return
        for reading in self._read_message(content, self.topic):
            stamp_ns = message.log_time_ns
            if self.topic.uses_header and reading.header is not None:
                stamp_ns = stamp_ns_of(reading) or message.log_time_ns
            stamp_ns += self.topic.time_offset_ns
            self._children |= {reading.child} - {""}
            defect = reading.defect or ("" if 0 <= stamp_ns < LIMIT_NS else "stamp outside 0 … 2^31 s")
            if defect == OTHER_FRAME:
                continue
            if defect:
                self._left_out[defect] += 1
                self._unused_joints |= dict.fromkeys(message.content.name) if defect == NO_JOINTS else {}
                continue
            self._readings.append(reading.values)
            self._times.append((stamp_ns, message.log_time_ns))
            frame = "" if reading.header is None else str(reading.header.frame_id)
            self._frames.append(self.topic.frame or frame or ROLES[self.topic.role].frame)

    def samples(self, local: LocalFrame) -> Samples:
        """Samples of all messages that were added."""
        topic = self.topic
        if partial := self._joints.close():
            self._left_out[PARTIAL] += partial
        if not self._readings:
            raise InputError(self._no_sample_text())
        if topic.child_frame is None and len(self._children) > 1:
            raise InputError(f"{topic.where}: {topic.source} moves several frames{self._accepted_children()}")
        stamps_ns, log_times_ns = np.array(self._times, np.int64).T
        columns, count = columns_of(self._readings), len(stamps_ns)
        variances = {axis: spread.variances(count, {}) for axis, spread in topic.spreads.items()}
        chosen = SelectedRows(np.ones(count, np.bool_))
        if topic.role == "pose":
            self._reject_poses(chosen, columns, variances, local)
        used = chosen.rows
        columns = {name: column[used] for name, column in columns.items()}
        variances = {axis: of_axis[used] for axis, of_axis in variances.items()}
        if topic.role == "pose":
            columns = local.with_east_north(columns)
        elif topic.role == "heading":
            columns = heading_columns(columns, topic)
        elif self._type_name == JOINTS:
            columns = joint_columns(columns, stamps_ns[used], topic)
        values = values_of(topic.role, columns, variances, stamps_ns[used], topic.geometry)
        frames = [self._frames[k] for k in np.flatnonzero(used).tolist()]
        frames = frames if len(set(frames)) > 1 else frames[:1]
        times = stamps_ns[used], log_times_ns[used]
        left_out = self._left_out + chosen.left_out
        return Samples(topic.name, topic.role, frames, *times, values, left_out, topic.source)

    def _reject_poses(
        self, chosen: SelectedRows, columns: Values, variances: Values, local: LocalFrame
    ) -> None:
        """Leave out poses without a variance of x or y, and positions off the map.

        Raises:
            InputError: all are to be left out, or none with a heading has a variance of yaw.
        """
        covariance = pose_covariance(columns, variances)
        has_variance = np.diagonal(covariance, axis1=1, axis2=2) > 0.0
        for k, axis in enumerate(("x", "y")):
            chosen.reject(~has_variance[:, k], f"no variance of {axis} above 0")
            if not chosen.rows.any():
                raise InputError(self._no_variance_text(axis))
        if "latitude" in columns:
            local.reject(chosen, columns, f"{self.topic.where}: {self.topic.source}")
            return
        has_heading = chosen.rows & np.isfinite(columns["yaw"])
        if has_heading.any() and not (has_heading & has_variance[:, 2]).any():
            raise InputError(self._no_variance_text("yaw"))

    def _no_variance_text(self, axis: str) -> str:
        topic = self.topic
        accepted = f"stddev: {{{axis}: …}}{', or position_only: true' if axis == 'yaw' else ''}"
        fault = f"{topic.source} states no variance of {axis} that is above 0"
        return f"{topic.where}: {fault}; accepted: {accepted}"

    def _accepted_children(self) -> str:
        """What is accepted as ``child_frame``; empty without transforms."""
        if not self._children:
            return ""
        return f"; accepted: child_frame, one of {joined_names(sorted(self._children))}"

    def _no_sample_text(self) -> str:
        """The reason why there is no sample."""
        topic = self.topic
        if self._unused_joints:
            requested = joint_names(topic)
            like = next((text for name in requested if (text := did_you_mean(name, self._unused_joints))), "")
            keys = JOINT if topic.role == "swing" else " and ".join(SIDES)
            asked = ", ".join(requested) + ("" if topic.joints else f" (no {keys} in the mapping)")
            there = ", ".join(self._unused_joints)
            if self._left_out[PARTIAL] and set(requested) <= self._unused_joints.keys():
                fault = f"no message of {topic.source}, and no messages of one stamp, hold {asked} together"
                return f"{topic.where}: {fault}; accepted: joints in one message, or with one stamp"
            return f"{topic.where}: {topic.source} has no joints {asked}{like}; accepted: {there}"
        reasons = ", ".join(f"{n}: {reason}" for reason, n in self._left_out.items())
        child = f" of child frame '{topic.child_frame}'" if topic.child_frame else ""
        fault = f"no message of {topic.source}{child} serves ({reasons or 'there is none'})"
        return f"{topic.where}: {fault}{self._accepted_children()}"
