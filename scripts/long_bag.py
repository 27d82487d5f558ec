# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Makes a bag of hours by repeating a short one: ``long_bag.py BAG OUTPUT --hours 8 [--live]``.

Stamps, log times and the journal's numbers go on from one repeat to the next; so do sprocket positions and,
where the bag has ``truth/odometry``, poses: each repeat begins where the one before it ended. With ``--live``
the short bag gets what its replay gives: ``odometry``, ``track_slip`` and ``measurement_reports``, as a
machine records them. It is for measuring how memory and time of the tools grow.
"""

import argparse
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from struct import Struct
from typing import Any, NamedTuple

import numpy as np

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.messages import make, serialize
from trackslip_bags.parameters import bag_parameters
from trackslip_bags.reader import Bag, open_bag
from trackslip_bags.sources import BagMessage
from trackslip_bags.types import fields_by
from trackslip_bags.writer import BagWriter
from trackslip_common.layout import Layout
from trackslip_common.message_fields import (
    RECORDS,
    OdometryFields,
    PoseFields,
    ReportFields,
    SprocketFields,
)
from trackslip_common.message_reading import read
from trackslip_common.orientations import heading_of
from trackslip_common.topics import ODOMETRY, TOPICS, TRACK_SLIP
from trackslip_estimation.slip import conversions
from trackslip_estimation.slip.estimator import make_step
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_tools.replay.inputs import REPORTS
from trackslip_tools.replay.output import message_of
from trackslip_tools.replay.parts import Part
from trackslip_tools.replay.run import replay

_STAMP, _POSITIONS, _NUMBER = Struct("<iI"), Struct("<2d"), Struct("<Q")
_XY, _Q = Struct("<2d"), Struct("<4d")
_NS = 1_000_000_000
_STAMP_AT = 4  # behind the header of CDR, in a message that begins with a std_msgs/Header
_REST_NS = 10_000_000  # between two repeats: the period of the sprockets

Pose = tuple[float, float, float]
Change = Callable[[bytearray, int, Pose], None]  # of a message; number and start of the repeat
_STAMPED = ("sensor_msgs/msg/LaserScan", "sensor_msgs/msg/MagneticField")  # beside those of RECORDS


class Offset(NamedTuple):
    """By how much a repeat is ahead of the one before it."""

    time_ns: int
    lines: int  # of the journal
    left: float  # rad
    right: float
    x: float  # m, of the motion that carries the start to the end
    y: float
    heading: float  # rad

    def pose(self, repeat: int) -> Pose:
        """The rigid motion that carries the first repeat to this one."""
        x = y = 0.0
        for k in range(repeat):
            c, s = math.cos(k * self.heading), math.sin(k * self.heading)
            x, y = x + c * self.x - s * self.y, y + s * self.x + c * self.y
        return x, y, repeat * self.heading


def main() -> None:
    """Write the long bag."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("bag", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--hours", type=float, required=True)
    parser.add_argument("--live", action="store_true")
    args = parser.parse_args()
    with open_bag(args.bag) as bag:
        lengthen(bag, args.output, args.hours * 3600.0, live=args.live)


def lengthen(bag: Bag, output: Path, seconds: float, *, live: bool) -> None:
    """Write repeats of the bag until they last so long."""
    messages = list(bag.messages())
    if live:
        messages = sorted((*messages, *_live(bag)), key=lambda message: message.log_time_ns)
    offset = _offset(bag, messages)
    changes = [_change(bag, message, offset) for message in messages]
    with BagWriter(output) as writer:
        for repeat in range(max(math.ceil(seconds * _NS / offset.time_ns), 1)):
            start = offset.pose(repeat)
            for message, change in zip(messages, changes, strict=True):
                data = bytearray(message.raw)
                change(data, repeat, start)
                logged_ns = message.log_time_ns + repeat * offset.time_ns
                writer.write(message.topic, message.type_name, bytes(data), logged_ns)


def _live(bag: Bag) -> Iterator[BagMessage]:
    """What the slip estimator publishes over the bag, logged as its measurement is."""
    p = load_slip_parameters(bag_parameters(bag))
    parts: list[Part] = []
    replay(bag, p, InputFilters(), None, watch=parts.append)
    arrivals, results = (
        np.concatenate([getattr(of, name) for of in parts]) for name in ("arrivals", "results")
    )
    for sequence, (arrival, found) in enumerate(zip(arrivals, results, strict=True)):
        report, estimate = make_step(found.item(), parts[0].sources[arrival["source"]])
        logged_ns = int(arrival["log_time_ns"])
        message = conversions.measurement_report(make, report, sequence)
        yield BagMessage(f"/{REPORTS}", TOPICS[REPORTS].type_name, logged_ns, serialize(message))
        if estimate is None:
            continue
        for topic in (ODOMETRY, TRACK_SLIP):
            raw = serialize(message_of(topic, estimate, p))
            yield BagMessage(f"/{topic}", TOPICS[topic].type_name, logged_ns, raw)


def _offset(bag: Bag, messages: list[BagMessage]) -> Offset:
    """From the first message of each kind to the last."""
    first: dict[str, Any] = {}
    last: dict[str, Any] = {}
    for message in messages:
        first.setdefault(message.topic, message)
        last[message.topic] = message

    def ends(topic: str, kind: Any) -> tuple[Any, Any]:
        found = (bag.deserialize(of[topic].raw, of[topic].type_name) for of in (first, last))
        before, after = (read(kind, message) for message in found)
        return before, after

    time_ns = messages[-1].log_time_ns - messages[0].log_time_ns + _REST_NS
    before, after = ends("/sprockets", SprocketFields)
    turned = (after.left_position - before.left_position, after.right_position - before.right_position)
    x = y = heading = 0.0
    if "/truth/odometry" in first:
        start, end = ends("/truth/odometry", OdometryFields)
        heading = heading_of(end) - heading_of(start)
        # the rigid motion that carries the start to the end, about the origin: a turn, then a shift
        turn_c, turn_s = math.cos(heading), math.sin(heading)
        x = end.x - (turn_c * start.x - turn_s * start.y)
        y = end.y - (turn_s * start.x + turn_c * start.y)
    lines = sum(message.topic == f"/{REPORTS}" for message in messages)
    return Offset(time_ns, lines, *turned, x, y, heading)


def _change(bag: Bag, message: BagMessage, offset: Offset) -> Change:
    """Stamp, and what else goes on from repeat to repeat."""
    kind = RECORDS.get(message.type_name)
    if kind is None and message.type_name not in _STAMPED:
        return lambda data, repeat, start: None
    sec, nanosec = _STAMP.unpack_from(message.raw, _STAMP_AT)
    more = _continued(bag, message, offset)

    def change(data: bytearray, repeat: int, start: Pose) -> None:
        stamp_ns = sec * _NS + nanosec + repeat * offset.time_ns
        _STAMP.pack_into(data, _STAMP_AT, *divmod(stamp_ns, _NS))
        more(data, repeat, start)

    return change


def _continued(bag: Bag, message: BagMessage, offset: Offset) -> Change:
    kind = RECORDS.get(message.type_name)
    if kind not in (SprocketFields, ReportFields, PoseFields, OdometryFields):
        return lambda data, repeat, start: None
    layout = Layout(fields_by(bag.store(message.type_name)), message.type_name, message.raw)
    if kind is SprocketFields:
        at = layout.offset("position")
        left, right = _POSITIONS.unpack_from(message.raw, at)
        return lambda data, repeat, start: _POSITIONS.pack_into(
            data, at, left + repeat * offset.left, right + repeat * offset.right
        )
    if kind is ReportFields:
        at = layout.offset("sequence")
        (number,) = _NUMBER.unpack_from(message.raw, at)
        return lambda data, repeat, start: _NUMBER.pack_into(data, at, number + repeat * offset.lines)
    place, turn = layout.offset("pose.pose.position.x"), layout.offset("pose.pose.orientation.x")
    x, y = _XY.unpack_from(message.raw, place)
    _, _, z, w = _Q.unpack_from(message.raw, turn)
    heading = 2.0 * math.atan2(z, w)

    def move(data: bytearray, repeat: int, start: Pose) -> None:
        c, s = math.cos(start[2]), math.sin(start[2])
        half = (heading + start[2]) / 2.0
        _XY.pack_into(data, place, start[0] + c * x - s * y, start[1] + s * x + c * y)
        _Q.pack_into(data, turn, 0.0, 0.0, math.sin(half), math.cos(half))

    return move


if __name__ == "__main__":
    main()
