# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Text description of a bag."""

from datetime import datetime, timezone

from trackslip_bags.namespace import machine_namespaces
from trackslip_bags.parameters import bag_vehicle
from trackslip_bags.reader import Bag, in_namespace
from trackslip_common.errors import printable
from trackslip_common.vehicle_files import DEFAULT_VEHICLE
from trackslip_tools.terminal_text import table, wrap_line

_CALENDAR_END_S = 253_402_300_800  # s since 1970, the end of the calendar
_COLUMNS = ("topic", "count", "Hz", "type")


def describe(bag: Bag) -> str:
    """Facts and a table of topics; rates are means over the bag's whole duration."""
    began, start = bag.start_ns * 1e-9, "?"
    if began < _CALENDAR_END_S:
        start = f"{datetime.fromtimestamp(began, tz=timezone.utc):%Y-%m-%d %H:%M:%S} UTC"
    lines = [
        f"bag       {bag.path}",
        f"start     {began:.3f} s ({start})",
        f"duration  {bag.duration_s:.3f} s",
        f"messages  {bag.message_count}",
    ]
    lines += _vehicle_lines(bag)
    if bag.damage:
        lines.append(f"damage    {bag.damage} (trackslip recover rewrites what can be read)")
    rows = [
        (
            printable(topic),
            str(info.count),
            f"{info.count / bag.duration_s:.2f}" if bag.duration_s > 0.0 else "-",
            printable(", ".join(sorted({info.type_name, *info.other_types}))),
        )
        for topic, info in sorted(bag.topics.items())
    ]
    return "\n".join([*map(wrap_line, lines), "", table(_COLUMNS, rows, (False, True, True, False))])


def _vehicle_lines(bag: Bag) -> list[str]:
    """One line for each machine, with its namespace."""
    lines = []
    for namespace in machine_namespaces(bag.topics) or [""]:
        vehicle = bag_vehicle(in_namespace(bag, namespace) if namespace else bag)
        name = f"not named: {DEFAULT_VEHICLE} is assumed" if vehicle is None else printable(vehicle.name)
        lines.append(f"vehicle   {name}" + (f" (--namespace {printable(namespace)})" if namespace else ""))
    return lines
