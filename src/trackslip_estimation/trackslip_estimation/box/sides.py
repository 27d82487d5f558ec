# SPDX-License-Identifier: Apache-2.0
"""Doubt about which sides of the box are seen, after a loss in which it could have turned by a quarter.

    Λ  χ² of the fit chosen less that of the fit a quarter turn away, summed over scans
    p  probability of the other, 1/(1 + e^{−Λ/2})

Half a turn leaves the box as it was: what the prediction cannot resolve of it stays in the variance.
The sides differ by little: one scan decides seldom, the sum does. Until then the heading's variance shows it.
"""

from dataclasses import dataclass

import numpy as np

DECISIVE = 30.0  # |Λ| that ends the doubt; large, for the ends' χ² is only nearly one
NEGLIGIBLE = 16.0  # Λ against half a turn: odds of 1 to 3000
LARGEST_STEP = 6.0  # of Λ in one scan: no single scan decides


@dataclass(frozen=True)
class SideDoubt:
    """turn: from the heading chosen to the other, ±π/2 rad; evidence: Λ, positive against that chosen."""

    turn: float
    evidence: float

    def after(self, difference: float) -> "SideDoubt | None":
        """With one more scan's Λ: turned over where the choice is refuted, None where it is confirmed."""
        evidence = self.evidence + float(np.clip(difference, -LARGEST_STEP, LARGEST_STEP))
        if evidence <= -DECISIVE:
            return None
        if evidence > 0.0:
            return SideDoubt(-self.turn, -evidence)
        return SideDoubt(self.turn, evidence)

    def probability(self) -> float:
        """Of the other heading."""
        return float(1.0 / (1.0 + np.exp(-0.5 * self.evidence)))


def half_turn_variance(turned: float, spread: float) -> float:
    """Second moment, rad², of the heading half a turn away about the one chosen.

    ``turned``: heading chosen less that predicted, rad; ``spread``: standard deviation of the latter, rad.
    """
    against = ((np.pi - abs(turned)) ** 2 - turned**2) / spread**2
    return float(np.pi**2 / (1.0 + np.exp(0.5 * against))) if against < NEGLIGIBLE else 0.0
