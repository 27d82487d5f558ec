# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Check that a state is finite; compiled.

``validity`` rejects measurements that would break a state, and ``kalman.positive`` keeps the covariance
positive definite. If a state is broken nevertheless, ``process`` counts a divergence and restarts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled

if TYPE_CHECKING:
    from trackslip_estimation.slip.records import State


@compiled
def is_finite_state(state: State, n: int) -> bool:
    """Whether means and variances of ``n`` states and the attitude are finite, no variance negative.

    Any other number that is not finite makes one of these not finite in the next step.
    """
    a, adaptation, positive = state.attitude, state.adaptation, True
    total, variances = adaptation.track_variance + adaptation.rate_factor, 0.0
    for k in range(n):
        total += state.mean[k]
        variances += state.covariance[k, k]
        positive &= state.covariance[k, k] >= 0.0
    if a.known == 1:
        for k in range(a.mean.size):
            total += a.mean[k]
            variances += a.covariance[k, k]
            positive &= a.covariance[k, k] >= 0.0
    return bool(positive and (total - total) + (variances - variances) == 0.0)
