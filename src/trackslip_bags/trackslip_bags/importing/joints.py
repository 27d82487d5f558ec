# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Joins JointState messages of one topic that hold some of the joints each, by their stamps."""

import math
from types import SimpleNamespace
from typing import Any

from trackslip_common.make import stamp_ns_of

_MAX_STAMPS = 64  # stamps with missing joints

PARTIAL = "holds some of the joints, and no other message of its stamp the rest"


class JointsByStamp:
    """Keeps parts of messages until all requested joints of a stamp have arrived.

    Args:
        requested: names of joints.
    """

    def __init__(self, requested: set[str]) -> None:
        self._requested = requested
        self._parts: dict[int, dict[str, tuple[float, float]]] = {}  # stamp → joint → position, velocity
        self.dropped = 0  # incomplete stamps that were discarded

    def add(self, message: Any) -> Any | None:
        """The message itself if it holds all requested joints or none; the joined one once all have arrived.

        None while some are missing.
        """
        joints = self._requested.intersection(message.name)
        if not joints or joints == self._requested:
            return message
        stamp_ns = stamp_ns_of(message)
        part = self._parts.setdefault(stamp_ns, {})
        for k, name in enumerate(message.name):
            part[name] = (_value_or_nan(message.position, k), _value_or_nan(message.velocity, k))
        if self._requested <= part.keys():
            del self._parts[stamp_ns]
            positions, velocities = zip(*part.values(), strict=True)
            return SimpleNamespace(
                header=message.header, name=list(part), position=positions, velocity=velocities
            )
        if len(self._parts) > _MAX_STAMPS:
            del self._parts[next(iter(self._parts))]
            self.dropped += 1
        return None

    def close(self) -> int:
        """Number of stamps that never had all joints."""
        return self.dropped + len(self._parts)


def _value_or_nan(values: Any, k: int) -> float:
    return float(values[k]) if k < len(values) else math.nan
