# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What is in a bag, as text."""

from datetime import datetime, timezone

from trackslip_bags.parameters import bag_vehicle
from trackslip_bags.reader import Bag
from trackslip_common.errors import printable
from trackslip_common.vehicle import ASSUMED
from trackslip_tools.terminal_text import table, wrapped

_LATEST = 253_402_300_800  # s since 1970, the end of the calendar
_HEAD = ("topic", "count", "Hz", "type")


def describe(bag: Bag) -> str:
    """A few facts and a table of topics; the rate is the mean over the bag's whole duration."""
    began = bag.start_ns * 1e-9
    start = (
        f"{datetime.fromtimestamp(began, tz=timezone.utc):%Y-%m-%d %H:%M:%S} UTC" if began < _LATEST else "?"
    )
    lines = [
        f"bag       {bag.path}",
        f"start     {began:.3f} s ({start})",
        f"duration  {bag.duration_s:.3f} s",
        f"messages  {bag.message_count}",
    ]
    vehicle = bag_vehicle(bag)
    lines.append(f"vehicle   {vehicle.name if vehicle is not None else f'not named: {ASSUMED} is assumed'}")
    if bag.damage:
        lines.append(f"damage    {bag.damage} (trackslip recover rewrites what can be read)")
    rows = [
        (
            printable(topic),
            str(info.count),
            _rate(info.count, bag.duration_s),
            printable(", ".join((info.type_name, *sorted(info.other_types)))),
        )
        for topic, info in sorted(bag.topics.items())
    ]
    return "\n".join([*map(wrapped, lines), "", table(_HEAD, rows, (False, True, True, False))])


def _rate(count: int, duration_s: float) -> str:
    return f"{count / duration_s:.2f}" if duration_s > 0.0 else "-"
