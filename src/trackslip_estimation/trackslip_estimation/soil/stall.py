# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Detects stalled and stuck tracks, compiled.

A stalled track is commanded and under high pressure, but does not turn. A stuck track spins at the limit of
the soil while the machine hardly moves. A track at slip i slides by i/(1 − i) of the machine's distance. In a
turn that exceeds the strength of the soil, the machine goes straight on at the speed of its inner track, and
the outer one slides by once to twice that distance. A track therefore spins from twice the distance on,
i > 2/3; a dragged track (i < 0) never spins.

Evidence counts up while the condition holds and down while it does not: a single noisy sample neither starts
nor ends a detection.

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


class TrackCondition(IntEnum):
    """Condition of a track."""

    NONE = 0
    STUCK = 1
    STALLED = 2


_NONE, _STUCK, _STALLED = map(int, TrackCondition)


@dataclass(frozen=True, kw_only=True)
class StallParameters(Parameters):
    """Conditions of a stalled track."""

    least_spool: float = parameter("least spool position that commands a track", gt=0.0, lt=1.0)
    least_pressure: float = parameter(
        "least pressure of a stalled track, as share of the relief pressure", gt=0.0
    )
    least_speed: float = parameter("least speed of a track that turns", unit="m/s", gt=0.0)
    time: float = parameter("duration of the condition after which a track is stalled", unit="s", gt=0.0)


@compiled
def stall_time(before: float, sample: Sample, side: int, p: StallParameters, relief_pressure: float) -> float:
    """Return the evidence, s, that a track is stalled, after one more sample; 0 if it is not commanded.

    ``side``: 0 left, 1 right; ``relief_pressure``: Pa.
    """
    spool = sample.spools[side] if sample.has_pressures else 0.0
    if not abs(spool) >= p.least_spool:  # not commanded, or unknown
        return 0.0
    is_pushed = sample.pressures[side] * (1.0 if spool > 0.0 else -1.0) >= p.least_pressure * relief_pressure
    return evidence_time(before, is_pushed and abs(sample.tracks[side]) < p.least_speed, sample.dt, p.time)


@compiled
def evidence_time(before: float, holds: bool, dt: float, time: float) -> float:
    """Return the evidence, s: raised by ``dt`` if the condition holds, else lowered; up to twice ``time``."""
    return min(max(before + (dt if holds else -dt), 0.0), 2.0 * time)


@compiled
def track_condition(stalled: float, spinning: float, p: SoilConfig) -> int:
    """Return the value of ``TrackCondition`` for the evidence of stalling and of spinning, s."""
    if stalled >= p.stall.time:
        return _STALLED
    return _STUCK if spinning >= p.stuck_time else _NONE
