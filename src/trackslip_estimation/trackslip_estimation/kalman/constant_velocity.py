# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Covariance of a quantity whose rate is a random walk; compiled.

Source: white noise acceleration, Bar-Shalom, Li & Kirubarajan (2001), section 6.2.2.
"""

from typing import NamedTuple

from trackslip_common.compiled import compiled


class RateCovariance(NamedTuple):
    """Covariance of a quantity and its rate."""

    variance: float  # of the quantity
    covariance: float
    rate_variance: float


@compiled
def propagate_rate_covariance(before: RateCovariance, dt: float, walk: float) -> RateCovariance:
    """Covariance ``dt`` s later, where the rate walks by ``walk`` per √s."""
    added = walk * walk * dt
    return RateCovariance(
        before.variance + (2.0 * before.covariance + (before.rate_variance + added / 3.0) * dt) * dt,
        before.covariance + (before.rate_variance + added / 2.0) * dt,
        before.rate_variance + added,
    )
