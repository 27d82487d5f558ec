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
def propagate_rate_covariance(known: RateCovariance, dt: float, walk: float) -> RateCovariance:
    """Covariance ``dt`` s later, where the rate walks by ``walk`` per √s."""
    more = walk * walk * dt
    return RateCovariance(
        known.variance + (2.0 * known.covariance + (known.rate_variance + more / 3.0) * dt) * dt,
        known.covariance + (known.rate_variance + more / 2.0) * dt,
        known.rate_variance + more,
    )
