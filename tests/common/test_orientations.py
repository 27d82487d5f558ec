# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Headings as text: an interval, or unknown."""

import math

import numpy as np
import pytest

from trackslip_common.orientations import heading_of, heading_text, headings_of, is_heading_known, tilts_of


@pytest.mark.parametrize("stddev", [1.81, math.inf, math.nan])
def test_heading_with_a_large_deviation_is_unknown(stddev: float) -> None:
    """π/√3 = 1.81 rad is the standard deviation of a uniform heading: ±1100° gives no information."""
    assert heading_text(0.3, stddev**2, 2.0) == "unknown"


def test_known_heading_has_its_interval() -> None:
    assert heading_text(math.pi / 6.0, math.radians(1.5) ** 2, 2.0) == "30.0° ± 3.0"
    assert heading_text(-0.1, math.radians(80.0) ** 2) == "-5.7° ± 80.0"


def test_known_headings_of_an_array() -> None:
    known = is_heading_known(np.array((0.01, 3.2, 3.3, math.nan)))
    np.testing.assert_array_equal(known, (True, True, False, False))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("number", [1e308, math.inf, math.nan])
def test_quaternion_of_absurd_numbers_raises_no_warning(number: float) -> None:
    """``replay`` and ``report`` read bags whose odometry has 1e308."""
    rows = np.zeros(2, [(name, np.float64) for name in ("qx", "qy", "qz", "qw")])
    rows["qw"] = 1.0
    rows[1] = (number, number, number, number)
    assert headings_of(rows)[0] == 0.0
    assert tilts_of(rows)[0].tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    "quaternion", [(0, 0, 0, 0), (0, 0, 0.7, 1.4), (0, 0, 0, math.nan), (1, 1, 1, 1e150)]
)
def test_quaternion_that_is_no_rotation_has_no_heading(quaternion: tuple[float, ...]) -> None:
    """Drivers leave it at zeros where they have no orientation: that is no heading to the east."""
    rows = np.array([quaternion, (0.0, 0.0, 0.7, 0.7)], float).view(
        [(name, np.float64) for name in ("qx", "qy", "qz", "qw")]
    )[:, 0]
    headings = headings_of(rows)
    assert math.isnan(headings[0])
    assert headings[1] == pytest.approx(math.pi / 2.0, abs=0.03)  # two digits, typed by hand
    np.testing.assert_array_equal(headings, [heading_of(row) for row in rows.view(np.recarray)])
