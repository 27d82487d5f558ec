# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fixes of a machine that stands share a part of their error; compiled.

    R    covariance of a fix, as its source states it and the noise factor has it
    ρ    share of its position's variance that all fixes of one stand have in common   1

A laser that sees the same edges by the same beams errs alike in every scan, so that averaging helps less and
less: n fixes of one stand have together ρ R + (1 − ρ) R/n, and not R/n. Of the heading they share nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.slip.models.model import SWING, YAW
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.source_offsets import errs_by_position

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State


_STANDING = int(Motion.STANDING)
_SWUNG = 0.1  # rad, beyond which what sits above is seen from another side


@compiled
def is_at_same_standstill(state: State, source: int, c: Config) -> bool:
    """Whether a sensor, whose fixes from one place share a part, stands where it was at the last."""
    standstill, shares = state.standstills[source], errs_by_position(source, c)
    turned = c.above[source] == 1 and abs(wrap(state.mean[SWING] - standstill.swing)) > _SWUNG
    is_standing = shares and state.motion.motion == _STANDING and not state.coasting
    return bool(is_standing and standstill.count > 0 and not turned)


@compiled
def standstill_inflation(count: int, share: float) -> float:
    """By how much R grows for the ``count``-th fix of a stand, of which all have ``share`` ρ in common."""
    before = share * (count - 1) + 1.0 - share
    return (before + share) * before / (1.0 - share)


@compiled
def inflate_repeated_fix(state: State, source: int, alone: bool, R: FloatArray, c: Config) -> None:
    """R of a fix that is used, ``alone`` or as one more of its stand; in place."""
    standstill = state.standstills[source]
    if alone:
        standstill.count, standstill.swing = 0, state.mean[SWING]
    standstill.count += 1
    again = np.sqrt(standstill_inflation(standstill.count, c.standing_share[source]))
    R[:YAW] *= again
    R[:, :YAW] *= again
