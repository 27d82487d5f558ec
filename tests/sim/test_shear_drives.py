# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Manoeuvres on the shear truth in which the errors are consistent with the covariance."""

import math
from pathlib import Path

import numpy as np
import pytest
from fixtures.shear_drives import replayed

SETTLING = 20.0  # s, until the fixes have determined the pose to millimetres
TO_AND_FRO = [(3.0, 0.0, 0.0), (5.0, 2.0, 2.0), (3.0, 0.0, 0.0), (5.0, -2.0, -2.0)]
TURNS = [
    *((5.0, 0.0, 0.0, math.pi / 2.0), (8.0, 2.2, 2.2), (6.0, 1.1, 2.2), (8.0, -1.9, -1.9), (2.0, 0.0, 0.0)),
    *((6.0, 2.2, 1.1), (8.0, -1.9, -1.9), (4.0, 1.3, 2.2), (2.0, 0.0, 0.0)),
]
TIGHT = (12.0, 0.1, 2.0)


@pytest.mark.slow
@pytest.mark.parametrize("soil", ["sand", "clayey_soil"])
def test_estimate_is_consistent_while_tracks_shear_the_soil_at_a_start(soil: str, tmp_path: Path) -> None:
    result = replayed(5 * TO_AND_FRO, soil, tmp_path)
    nees = result.nees[result.t > SETTLING]
    assert np.sqrt(nees.max()) < 4.0
    assert nees.mean() < 3.0  # 2 if consistent


@pytest.mark.slow
def test_tight_turn_does_not_move_the_estimate(tmp_path: Path) -> None:
    """The cab points to the left: the left track bears most of the load, and the right one spins.

    The machine hardly turns or moves.
    """
    blind_from = sum(duration for duration, *_ in TURNS)
    segments = [*TURNS, TIGHT, (1.0, 0.0, 0.0)]
    result = replayed(segments, "sand", tmp_path, vehicle="pc05_cab", blind_from=blind_from)
    assert np.hypot(*result.errors[-1]) < 0.15
    assert np.sqrt(result.nees[-1]) < 3.0
