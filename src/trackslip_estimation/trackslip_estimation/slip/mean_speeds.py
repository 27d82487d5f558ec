# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Mean sprocket speeds between two readings of a source; compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from trackslip_common.compiled import compiled

if TYPE_CHECKING:
    from trackslip_estimation.slip.records import State


class MeanSpeeds(NamedTuple):
    """Mean speeds of both sprockets over T."""

    left: float  # rad/s
    right: float  # rad/s
    T: float  # s


@compiled
def mean_speeds_since(state: State, source: int, stamp_ns: int) -> MeanSpeeds:
    """Mean speeds from the latest reading of a source, before ``stamp_ns``, to the state."""
    last = state.readings[source]
    T = (stamp_ns - last.stamp_ns) * 1e-9
    left, right = (
        state.sprocket_angles[0] - last.sprocket_angles[0],
        state.sprocket_angles[1] - last.sprocket_angles[1],
    )
    return MeanSpeeds(left / T, right / T, T)


@compiled
def store_reading(state: State, source: int, stamp_ns: int) -> None:
    """Store the latest reading of a source."""
    last = state.readings[source]
    last.stamp_ns, last.sprocket_angles[:] = stamp_ns, state.sprocket_angles
