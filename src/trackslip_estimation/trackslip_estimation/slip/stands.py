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
from trackslip_estimation.slip.own_errors import errs_by_place

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State


_STANDING = int(Motion.STANDING)
_SWUNG = 0.1  # rad, beyond which what sits above is seen from another side


@compiled
def stands_still(state: State, source: int, c: Config) -> bool:
    """Whether a sensor, whose fixes from one place share a part, stands where it was at the last."""
    stand, shares = state.stands[source], errs_by_place(source, c)
    turned = c.above[source] == 1 and abs(wrap(state.mean[SWING] - stand.swing)) > _SWUNG
    stands = shares and state.motion.motion == _STANDING and not state.coasting
    return bool(stands and stand.count > 0 and not turned)


@compiled
def repeats_stand(count: int, share: float) -> float:
    """By how much R grows for the ``count``-th fix of a stand, of which all have ``share`` ρ in common."""
    before = share * (count - 1) + 1.0 - share
    return (before + share) * before / (1.0 - share)


@compiled
def count_fix(state: State, source: int, alone: bool, R: FloatArray, c: Config) -> None:
    """R of a fix that is used, ``alone`` or as one more of its stand; in place."""
    stand = state.stands[source]
    if alone:
        stand.count, stand.swing = 0, state.mean[SWING]
    stand.count += 1
    again = np.sqrt(repeats_stand(stand.count, c.standing_share[source]))
    R[:YAW] *= again
    R[:, :YAW] *= again
