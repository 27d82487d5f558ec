# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What is known of a number that changes at a rate of its own, which walks; compiled.

Source: white noise acceleration, Bar-Shalom, Li & Kirubarajan (2001), section 6.2.2.
"""

from typing import NamedTuple

from trackslip_common.compiled import compiled


class Known(NamedTuple):
    """Covariance of a number and its rate."""

    variance: float  # of the number
    covariance: float
    rate_variance: float


@compiled
def later(known: Known, dt: float, walk: float) -> Known:
    """What is known ``dt`` s later of a rate that walks by ``walk`` in √s."""
    more = walk * walk * dt
    return Known(
        known.variance + (2.0 * known.covariance + (known.rate_variance + more / 3.0) * dt) * dt,
        known.covariance + (known.rate_variance + more / 2.0) * dt,
        known.rate_variance + more,
    )
