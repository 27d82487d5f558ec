# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Finds tracks in trouble, compiled.

Stalled is commanded but not turning at high pressure; stuck is spinning at the limit of the soil while the
machine hardly moves. A track at slip i slides by i/(1 − i) of the machine's way: where a turn asks more of
the soil than it bears, the machine goes straight on at the pace of its inner track, and the outer one slides
by once to twice that way. So it spins from twice on, i > 2/3; one that is dragged (i < 0) never does.

Evidence counts up for as long as it lasts, down where it is gone: a noisy moment neither ends a trouble nor
makes one.

p, s, u    differential pressure, spool position, track speed      Pa, 1, m/s
stalled    |s| ≥ s_min, p sign(s) ≥ p_min, |u| < u_min             for ``time``
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_common.parameters import Parameters, parameter
from trackslip_estimation.soil.interpolation import Sample

if TYPE_CHECKING:
    from trackslip_estimation.soil.soil_parameters import SoilConfig


class Trouble(IntEnum):
    """Of a track."""

    NONE = 0
    STUCK = 1
    STALLED = 2


_NONE, _STUCK, _STALLED = map(int, Trouble)


@dataclass(frozen=True, kw_only=True)
class StallParameters(Parameters):
    """When a track is stalled."""

    least_spool: float = parameter("position of a valve's spool that commands its track", gt=0.0, lt=1.0)
    least_pressure: float = parameter("as share of the relief pressure, with which a track is pushed", gt=0.0)
    least_speed: float = parameter("of a track that turns", unit="m/s", gt=0.0)
    time: float = parameter("for which it must last", unit="s", gt=0.0)


@compiled
def stall_time(before: float, sample: Sample, side: int, p: StallParameters, relief_pressure: float) -> float:
    """Seconds for which a track has been stalled, less those against it, after one more sample.

    ``side``: 0 left, 1 right; ``relief_pressure``: Pa.
    """
    spool = sample.spools[side] if sample.has_pressures else 0.0
    if not abs(spool) >= p.least_spool:  # not commanded, or not known
        return 0.0
    pushed = sample.pressures[side] * (1.0 if spool > 0.0 else -1.0) >= p.least_pressure * relief_pressure
    return evidence_time(before, pushed and abs(sample.tracks[side]) < p.least_speed, sample.dt, p.time)


@compiled
def evidence_time(before: float, seen: bool, dt: float, needed: float) -> float:
    """Up by ``dt`` where it is seen, down where not; between 0 and twice what is needed."""
    return min(max(before + (dt if seen else -dt), 0.0), 2.0 * needed)


@compiled
def trouble_of(stalled: float, spinning: float, p: SoilConfig) -> int:
    """Place in ``Trouble``, of seconds for each."""
    if stalled >= p.stall.time:
        return _STALLED
    return _STUCK if spinning >= p.stuck_time else _NONE
