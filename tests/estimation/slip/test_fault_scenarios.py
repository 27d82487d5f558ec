# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""One emulated drive with each fault of a sensor, and the expected result.

``test_arrival_order`` and ``test_clock_jumps`` have order, repeats, invalid measurements and clocks. A
fault begins at ``BEGIN`` s of data, during a turn. ``during`` is the largest position error from its start
to a second after its end, ``recovery`` the time after its end from which the error stays below ``GOOD``.
"""

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from trackslip_estimation.slip.estimator import Estimate, SlipEstimator
from trackslip_estimation.slip.measurements import Measurement, Outcome, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip.parameters import load_slip_parameters

BEGIN = 25.0  # s, since the first stamp
GOOD = 0.04  # m
Log = Any  # a type of conftest.py
Given = list[Measurement]
Counts = Counter[tuple[str, str]]


@dataclass
class Run:
    """Estimates, outcomes and errors of a run."""

    published: list[Estimate]
    counts: Counts  # by (source, outcome)
    seconds: np.ndarray[Any, np.dtype[np.float64]]  # stamps of the estimates, since the first stamp
    errors: np.ndarray[Any, np.dtype[np.float64]]  # (n, 3) m, m, rad

    @property
    def position(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """(n,) position errors, m."""
        return np.hypot(self.errors[:, 0], self.errors[:, 1])

    def during(self, end: float) -> float:
        """Largest position error from the start of a fault to a second after its end, m."""
        inside = (self.seconds >= BEGIN) & (self.seconds <= end + 1.0)
        return float(self.position[inside].max())

    def recovery(self, end: float) -> float:
        """Time from the end of a fault to the last position error above ``GOOD``, s."""
        bad = self.seconds[(self.position > GOOD) & (self.seconds > end)]
        return float(bad.max()) - end if bad.size else 0.0


def seconds_of(log: Log, m: Measurement) -> float:
    return (m.stamp_ns - log.measurements[0].stamp_ns) * 1e-9


def run(log: Log, given: Iterable[Measurement], **changes: Any) -> Run:
    """Run the estimator and assert that all published values are finite."""
    estimator = SlipEstimator(load_slip_parameters(changes))
    steps = [estimator.process(m) for m in given]
    published = [e for _, e in steps if e is not None]
    poses, covariances = (np.array([getattr(e, of) for e in published]) for of in ("pose", "pose_covariance"))
    assert np.isfinite(poses).all()
    assert np.isfinite(covariances).all()
    for name in ("twist", "twist_covariance", "slips", "slip_covariance"):
        assert np.isfinite([getattr(e.outputs, name) for e in published]).all()
    assert np.linalg.eigvalsh(covariances)[:, 0].min() > 0.0
    stamps = np.array([e.stamp_ns for e in published])
    errors = poses - log.true_pose(stamps)
    errors[:, 2] = np.angle(np.exp(1j * errors[:, 2]))
    counts = Counter((r.source, r.outcome.name) for r, _ in steps if r.outcome is not Outcome.ACCEPTED)
    del counts["sprockets", "WAITING"], counts["imu/data_raw", "WAITING"]  # before the first fix
    return Run(published, counts, (stamps - log.measurements[0].stamp_ns) * 1e-9, errors)


def changed(log: Log, kind: type, end: float, change: Callable[[Any], Measurement | None]) -> Given:
    """The measurements with those of ``kind`` between ``BEGIN`` and ``end`` changed, or left out for None."""
    made = [
        change(m) if isinstance(m, kind) and BEGIN <= seconds_of(log, m) < end else m
        for m in log.measurements
    ]
    return [m for m in made if m is not None]


def test_without_a_fault(log: Log) -> None:
    found = run(log, log.measurements)
    assert found.counts == {}
    assert found.during(45.0) < GOOD
    assert np.sqrt(np.mean(found.position**2)) < 0.015


@pytest.mark.parametrize("jump", [(0.5, 0.0, 0.0), (0.0, 0.0, np.pi), (9e7, 0.0, 0.0)])
def test_spike(log: Log, jump: tuple[float, float, float]) -> None:
    """One fix is an outlier: it is rejected and has no effect."""
    found = run(log, changed(log, PoseFix, BEGIN + 0.2, lambda m: replace(m, pose=m.pose + np.array(jump))))
    assert found.counts == {("box_pose", "GATED"): 1}
    assert found.during(BEGIN + 0.2) < GOOD


def test_gyro_spikes(log: Log) -> None:
    """A loose plug for 3 s, ±99 rad/s in every third sample: all are rejected and have no effect."""
    turns = iter(range(10**6))

    def loose(m: YawRate) -> YawRate:
        k = next(turns)
        return replace(m, rate=99.0 * (-1) ** k) if k % 3 == 0 else m

    found = run(log, changed(log, YawRate, BEGIN + 3.0, loose))
    assert set(found.counts) == {("imu/data_raw", "GATED")}
    assert found.during(BEGIN + 3.0) < GOOD


def test_stuck_encoder(log: Log) -> None:
    """The left encoder reports standstill for 5 s while its track drives.

    With a small yaw rate and a turn about one track, the speed seems to be zero: 1.6 m of error. Fixes
    bound the error.
    """
    stuck: list[float] = []

    def hold(m: Sprockets) -> Sprockets:
        assert m.positions is not None
        stuck.append(m.positions[0])
        return replace(m, positions=(stuck[0], m.positions[1]), left_speed=0.0)

    found = run(log, changed(log, Sprockets, BEGIN + 5.0, hold))
    assert found.counts["sprockets", "JUMPED"] == 1  # when the encoder works again
    assert found.during(BEGIN + 5.0) < 1.3
    assert found.recovery(BEGIN + 5.0) < 15.0


def test_gyro_with_its_sign_flipped(log: Log) -> None:
    """Heading is wrong in turns, fixes keep the position; the parameter ``sign`` restores the estimate."""
    flipped = [replace(m, rate=-m.rate) if isinstance(m, YawRate) else m for m in log.measurements]
    wrong = run(log, flipped)
    assert wrong.position[wrong.seconds > 5.0].max() < 0.12
    assert 0.03 < np.abs(wrong.errors[:, 2]).max() < 0.35
    cured, right = run(log, flipped, **{"sources.imu_data_raw.sign": -1}), run(log, log.measurements)
    np.testing.assert_array_equal(cured.errors, right.errors)


@pytest.mark.parametrize("kind", [YawRate, PoseFix])
def test_outage(log: Log, kind: type) -> None:
    """10 s without gyro or without fixes."""
    found = run(log, changed(log, kind, BEGIN + 10.0, lambda _: None))
    assert found.counts == {}
    assert found.during(BEGIN + 10.0) < (GOOD if kind is YawRate else 0.15)
    assert found.recovery(BEGIN + 10.0) < 0.5


def test_everything_silent(log: Log) -> None:
    """All sources are silent for 10 s; the first fixes after it restore the pose."""
    end = BEGIN + 10.0
    given = [m for m in log.measurements if not BEGIN <= seconds_of(log, m) < end]
    found = run(log, given)
    assert found.counts["sprockets", "AHEAD"] == 19  # until the new time is accepted
    assert found.recovery(end) < 1.0


@pytest.mark.parametrize("start", [12.0, 16.0, 27.0])
def test_started_mid_drive(log: Log, start: float) -> None:
    """In a turn or straight on: accurate from the first fix, and fully accurate within 5 s."""
    found = run(log, [m for m in log.measurements if seconds_of(log, m) > start])
    assert found.seconds[0] < start + 1.0
    assert found.position.max() < 0.12
    assert found.position[found.seconds > start + 5.0].max() < GOOD
