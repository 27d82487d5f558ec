# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The truth around a time that advances, so that no drive need be in memory whole."""

from collections.abc import Iterable

from trackslip_sim.truth.record import Truth, joined

KEPT = 20.0  # s behind that time which can still be looked at
_AHEAD = 3  # samples: derivatives at the two about a time need one more


class TruthWindow:
    """Pieces of one drive; each is computed when its time comes, and forgotten ``KEPT`` s later.

    Attributes:
        truth: the stretch at hand.
        duration: of the whole drive, s.
    """

    def __init__(self, pieces: Iterable[Truth], duration: float) -> None:
        self._pieces = iter(pieces)
        self.duration = duration
        self._begin(next(self._pieces))

    def advance(self, t: float) -> bool:
        """Go on to time ``t``, s; whether there is a new stretch."""
        advanced = False
        while t > self._until:
            piece = next(self._pieces, None)
            if piece is None:
                break
            self._begin(joined([self.truth.since(t - KEPT), piece]))
            advanced = True
        return advanced

    def _begin(self, truth: Truth) -> None:
        self.truth = truth
        self._until = float(truth.t[max(-_AHEAD, -len(truth))])
