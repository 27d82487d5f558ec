# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Dead-reckoned paths of drives with analytically known ends."""

import math
from dataclasses import replace

import numpy as np
import pytest
from fixtures.arrival_rows import rows_of
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from trackslip_common.vehicle import Kinematics
from trackslip_estimation.slip.measurements import Sprockets, YawRate
from trackslip_tools.replay.dead_reckoning import DeadReckoner
from trackslip_tools.replay.series import Path, series_of

MS = 1_000_000
EPOCH_NS = 1_700_000_000_000_000_000  # resolution of float seconds here: 240 ns
ORIGIN = np.zeros(3)


def vehicle() -> Kinematics:
    return Kinematics(rolling_radius=0.2, tread=0.8, contact_length=1.2)


def samples(
    left: float, right: float, seconds: float, positions: bool = True, period_ms: int = 10
) -> list[Sprockets]:
    sprockets = []
    for k in range(round(seconds * 1e3 / period_ms) + 1):
        t = k * period_ms * 1e-3
        angles = (7.0 + left * t, -3.0 + right * t) if positions else None
        sprockets.append(Sprockets("sprockets", EPOCH_NS + k * period_ms * MS, left, right, angles))
    return sprockets


def reckoned(
    sprockets: list[Sprockets], start_ns: int, start: NDArray[np.float64], gyro: list[YawRate] | None = None
) -> Path:
    """Path of measurements in two batches, those of the gyro last."""
    reckoner = DeadReckoner(vehicle(), with_gyro=gyro is not None)
    for batch in (sprockets[: len(sprockets) // 2], [*sprockets[len(sprockets) // 2 :], *(gyro or ())]):
        x, y, heading = start[:, np.newaxis]
        reference = series_of(stamp_ns=[start_ns], x=x, y=y, heading=heading).rows
        reckoner.add(rows_of([(0, m) for m in batch], ("sprockets", "imu")), reference)
    path, _ = reckoner.result()
    assert path is not None
    return path


@given(
    left=st.floats(-3.0, 3.0),
    right=st.floats(-3.0, 3.0),
    start=st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.floats(-3.0, 3.0)),
    positions=st.booleans(),
)
def test_constant_speeds_give_a_straight_line_or_an_arc(
    left: float, right: float, start: tuple[float, float, float], positions: bool
) -> None:
    """The heading is continuous; the chord of the arc has the mean of the headings at its ends."""
    path = reckoned(samples(left, right, 5.0, positions), EPOCH_NS, np.array(start))
    t = (path.stamps_ns - EPOCH_NS) * 1e-9
    turned = 0.2 * (right - left) / 0.8 * t
    chords = 0.1 * (left + right) * t * np.sinc(turned / (2.0 * np.pi))
    x, y, heading = start
    mean = heading + turned / 2.0
    expected = np.column_stack((x + chords * np.cos(mean), y + chords * np.sin(mean), heading + turned))
    np.testing.assert_allclose(path.poses, expected, atol=1e-3)
    assert t[[0, -1]].tolist() == [0.0, 5.0]


def test_gyro_replaces_the_yaw_rate_of_the_sprockets() -> None:
    """Sprockets indicate straight driving; the gyro turns by a quarter circle."""
    rate = math.pi / 2.0 / 5.0
    gyro = [YawRate("imu", EPOCH_NS + k * 100 * MS + 3 * MS, rate, 1e-4) for k in range(-5, 60)]
    path = reckoned(samples(2.0, 2.0, 5.0), EPOCH_NS, ORIGIN, gyro)
    radius = 2.0 * 0.2 / rate
    np.testing.assert_allclose(path.poses[-1], (radius, radius, math.pi / 2.0), atol=1e-4)


def test_a_changing_rate_is_integrated_by_the_trapezoidal_rule() -> None:
    gyro = [YawRate("imu", EPOCH_NS + k * 100 * MS, 0.1 * k, 1e-4) for k in range(11)]  # φ = t²/2
    path = reckoned(samples(0.0, 0.0, 1.0), EPOCH_NS, ORIGIN, gyro)
    np.testing.assert_allclose(path.poses[[50, 100], 2], (0.125, 0.5), atol=1e-9)


def test_a_start_between_samples_counts_from_there() -> None:
    start_ns = EPOCH_NS + 2_003 * MS
    path = reckoned(samples(1.0, 1.0, 5.0), start_ns, np.array((10.0, 0.0, 0.0)))
    assert path.stamps_ns[0] == start_ns
    np.testing.assert_allclose(path.poses[[0, -1], 0], (10.0, 10.0 + 0.2 * 2.997), atol=1e-9)
    turned = reckoned(samples(1.0, 2.0, 5.0), start_ns, np.array((0.0, 0.0, 0.5)))
    np.testing.assert_allclose(turned.poses[[0, -1], 2], (0.5, 0.5 + 0.25 * 2.997), atol=1e-9)


def test_a_measured_speed_is_that_of_the_time_before_it() -> None:
    fast, *others = samples(1.0, 1.0, 0.02, positions=False)
    path = reckoned([replace(fast, left_speed=9.0), *others], EPOCH_NS, ORIGIN)
    np.testing.assert_allclose(path.poses[-1], (0.2 * 0.02, 0.0, 0.0), atol=1e-12)


def test_positions_are_preferred_to_speeds() -> None:
    with_wrong_speeds = [replace(s, left_speed=9.0, right_speed=-9.0) for s in samples(1.0, 1.0, 1.0)]
    path = reckoned(with_wrong_speeds, EPOCH_NS, ORIGIN)
    np.testing.assert_allclose(path.poses[-1], (0.2, 0.0, 0.0), atol=1e-9)


def test_a_path_between_samples_is_linear_and_unknown_outside() -> None:
    stamps = np.array((EPOCH_NS, EPOCH_NS + 100 * MS), dtype=np.int64)
    path = Path(stamps, np.array(((0.0, 0.0, 0.0), (1.0, 2.0, 3.0))))
    stamps_ns = EPOCH_NS + np.array((-1, 0, 25, 100, 101), dtype=np.int64) * MS
    poses = path.poses_at(stamps_ns)
    np.testing.assert_allclose(poses[1:4], ((0.0, 0.0, 0.0), (0.25, 0.5, 0.75), (1.0, 2.0, 3.0)), atol=1e-9)
    assert np.isnan(poses[[0, 4]]).all()


def test_non_finite_measurements_are_ignored_and_the_gyro_held_where_it_is_silent() -> None:
    bad = replace(samples(1.0, 1.0, 0.0)[0], stamp_ns=EPOCH_NS + 5 * MS, left_speed=math.nan)
    gyro = [YawRate("imu", EPOCH_NS + 500 * MS, 0.3, 1e-4), YawRate("imu", EPOCH_NS, math.inf, 1e-4)]
    path = reckoned([*samples(0.0, 0.0, 1.0), bad], EPOCH_NS, ORIGIN, gyro)
    assert len(path.stamps_ns) == 101
    assert path.poses[-1, 2] == pytest.approx(0.3)
