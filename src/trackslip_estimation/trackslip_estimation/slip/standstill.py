# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fixes of a machine at standstill share a part of their error; compiled.

    R    covariance of a fix, stated variance times noise factor
    ρ    share of the position variance that all fixes of a standstill have in common   1

A laser that measures the same edges with the same beams repeats its error in every scan. The mean of n fixes
of a standstill has the variance ρ R + (1 − ρ) R/n, and not R/n. Heading errors are independent.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.slip.models.model import SWING, YAW
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.source_offsets import has_position_dependent_errors

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State


_STANDING = int(Motion.STANDING)
_LARGEST_SWING = 0.1  # rad of swing, beyond which a sensor on the upper structure sees another side


@compiled
def is_at_same_standstill(state: State, source: int, c: Config) -> bool:
    """Whether a source with position-dependent errors has not moved since its latest fix."""
    standstill = state.standstills[source]
    has_swung = c.above[source] == 1 and abs(wrap(state.mean[SWING] - standstill.swing)) > _LARGEST_SWING
    if not has_position_dependent_errors(source, c) or has_swung or standstill.count == 0:
        return False
    return bool(state.motion.motion == _STANDING and not state.coasting)


@compiled
def standstill_inflation(count: int, share: float) -> float:
    """Factor of R for the ``count``-th fix of a standstill with a common ``share`` ρ."""
    before = share * (count - 1) + 1.0 - share
    return (before + share) * before / (1.0 - share)


@compiled
def inflate_repeated_fix(state: State, source: int, is_independent: bool, R: FloatArray, c: Config) -> None:
    """Inflate R of an accepted fix, if it is not the first of its standstill; in place."""
    standstill = state.standstills[source]
    if is_independent:
        standstill.count, standstill.swing = 0, state.mean[SWING]
    standstill.count += 1
    scale = np.sqrt(standstill_inflation(standstill.count, c.standing_share[source]))
    R[:YAW] *= scale
    R[:, :YAW] *= scale
