# SPDX-License-Identifier: Apache-2.0
"""What a node reports on /diagnostics."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK,
    DiagnosticStatus.WARN,
    DiagnosticStatus.ERROR,
    DiagnosticStatus.STALE,
)


@dataclass(frozen=True)
class Health:
    """One line of /diagnostics."""

    level: bytes
    message: str
    values: dict[str, Any] = field(default_factory=dict)
    part: str = ""  # of the node; empty for the node itself


def diagnostics(node: str, stamp: Time, entries: Iterable[Health], hardware: str) -> DiagnosticArray:
    """The message with these lines; ``hardware`` tells the device of one node from that of its twin."""
    array = DiagnosticArray()
    array.header.stamp = stamp
    for entry in entries:
        status = DiagnosticStatus(level=entry.level, message=entry.message, hardware_id=hardware)
        status.name = f"{node}: {entry.part}" if entry.part else node
        status.values = [KeyValue(key=k, value=str(v)) for k, v in entry.values.items()]
        array.status.append(status)
    return array
