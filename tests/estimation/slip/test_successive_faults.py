# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Two sensors fail one after the other, or at once: the estimate is right again after both faults."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from fixtures.drawn_machine import FIX, GNSS, Machine, drive, parameters, with_coarse_fixes
from fixtures.fault_cases.case import seconds
from fixtures.pose_errors import errors_over

from trackslip_estimation.slip.measurements import Measurement, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip.parameters import load_slip_parameters

Change = Callable[[Measurement, np.random.Generator], Measurement | None]
SECOND = "second"  # another receiver
DRIFT = 76.3, 83.5  # s, of both receivers
WITHOUT_HEADING = Machine().heading_noise


class Fault(NamedTuple):
    """A change of measurements within a time; a changed measurement None is lost."""

    change: Change
    begin: float  # s
    end: float  # s


class Succession(NamedTuple):
    """Faults of one drive, and its sensors."""

    faults: Sequence[Fault]
    fix_rate: int  # Hz
    track_error: float = 0.0
    heading_noise: float = WITHOUT_HEADING  # rad
    seed: int = 0
    fault_seed: int = 0
    coarse: bool = False
    recovery: float = 30.0  # s after the last fault


def no_sprockets(m: Measurement, random: np.random.Generator) -> Measurement | None:
    return None if isinstance(m, Sprockets) else m


def zero_sprockets(m: Measurement, random: np.random.Generator) -> Measurement:
    return replace(m, left_speed=0.0, right_speed=0.0) if isinstance(m, Sprockets) else m


def reversed_gyro(m: Measurement, random: np.random.Generator) -> Measurement:
    return replace(m, rate=-m.rate) if isinstance(m, YawRate) else m


def biased_gyro(m: Measurement, random: np.random.Generator) -> Measurement:
    return replace(m, rate=m.rate + 0.05) if isinstance(m, YawRate) else m


def doubled_gyro(m: Measurement, random: np.random.Generator) -> Measurement:
    return replace(m, rate=2.0 * m.rate) if isinstance(m, YawRate) else m


def noisy_gyro(m: Measurement, random: np.random.Generator) -> Measurement:
    return replace(m, rate=m.rate + 0.2 * random.standard_normal()) if isinstance(m, YawRate) else m


def scattered_fixes(m: Measurement, random: np.random.Generator) -> Measurement:
    if not isinstance(m, PoseFix):
        return m
    return replace(m, pose=m.pose + np.append(random.normal(0.0, 3.0, 2), 0.0))


def drifting_fixes(m: Measurement, random: np.random.Generator) -> Measurement:
    if not isinstance(m, PoseFix):
        return m
    since = seconds(m) - DRIFT[0]
    return replace(m, pose=m.pose + since * np.array((-0.0572, -0.2705, 0.0)))


def turned_headings(m: Measurement, random: np.random.Generator) -> Measurement:
    return replace(m, pose=m.pose + np.array((0.0, 0.0, 0.4))) if isinstance(m, PoseFix) else m


SUCCESSIONS: Mapping[str, Succession] = {
    "scattered fixes, a reversed gyro": Succession(
        [Fault(scattered_fixes, 77.2, 94.1), Fault(reversed_gyro, 79.5, 87.6)], 2, 0.02, seed=1, fault_seed=5
    ),
    "a reversed gyro, sprockets that show 0": Succession(
        [Fault(reversed_gyro, 43.8, 106.2), Fault(zero_sprockets, 54.5, 76.8)], 10
    ),
    "headings that are off, a biased gyro": Succession(
        [Fault(turned_headings, 77.2, 94.1), Fault(biased_gyro, 79.5, 87.6)], 2, 0.02, 0.02, seed=1
    ),
    "a gyro that shows twice the rate, and noise, beside headings": Succession(
        [Fault(doubled_gyro, 40.3, 57.2), Fault(noisy_gyro, 56.2, 59.3)], 10, 0.0, 0.02, seed=1
    ),
    "silent sprockets, which then show 0, under coarse fixes": Succession(
        [Fault(no_sprockets, 40.7, 79.5), Fault(zero_sprockets, 79.5, 94.8)],
        10,
        0.02,
        coarse=True,
        recovery=50.0,
    ),
}


def with_faults(measurements: Sequence[Measurement], faults: Sequence[Fault], seed: int) -> list[Measurement]:
    """The measurements, each changed by the faults of its time."""
    random, changed = np.random.default_rng(seed), list[Measurement]()
    for m in measurements:
        found: Measurement | None = m
        for fault in faults:
            if found is not None and fault.begin <= seconds(m) < fault.end:
                found = fault.change(found, random)
        if found is not None:
            changed.append(found)
    return changed


@pytest.mark.parametrize("name", SUCCESSIONS)
def test_estimate_is_right_after_two_faults(name: str) -> None:
    s = SUCCESSIONS[name]
    last = max(fault.end for fault in s.faults)
    machine = Machine(
        duration=last + s.recovery + 40.0,
        fix_rate=s.fix_rate,
        track_error=s.track_error,
        surge=0.0 if s.coarse else 0.3,
        heading_noise=s.heading_noise,
        seed=s.seed,
    )
    recording = drive(machine)
    measurements = with_coarse_fixes(recording, 1.0, 60.0) if s.coarse else recording.measurements
    p = parameters(**GNSS)
    if s.heading_noise < WITHOUT_HEADING:
        p = load_slip_parameters({**GNSS, "sources.box_pose.yaw_offset_stddev": 0.02})
    errors, _ = errors_over(with_faults(measurements, s.faults, s.fault_seed), recording, p)
    after = errors.between(last + s.recovery)
    assert after.rms < (4.0 if s.coarse else 0.1)
    assert after.nees(2).mean() < 8.0
    assert after.heading_rms < (0.3 if s.coarse else 0.1)


def test_two_receivers_that_both_seemed_off_are_followed_again() -> None:
    """A biased gyro; then both drift by 2 m, as with wrong corrections, and return."""
    recording = drive(Machine(duration=150.0, fix_rate=1))
    random, second = np.random.default_rng(1081), list[Measurement]()
    for k in range(1, len(recording.t), 5):
        pose = np.append(recording.poses[k, :2] + 0.03 * random.standard_normal(2), 0.0)
        stamp_ns = 10**9 + round(recording.t[k] * 1e9)
        second.append(PoseFix(SECOND, stamp_ns, pose, np.diag((0.03**2, 0.03**2, 100.0))))
    faults = [Fault(biased_gyro, 57.8, 72.45), Fault(drifting_fixes, *DRIFT)]
    measurements = sorted([*recording.measurements, *second], key=lambda m: m.stamp_ns)
    p = parameters(
        pose_sources=[FIX, SECOND],
        **GNSS,
        **{name.replace(FIX, SECOND): value for name, value in GNSS.items()},
        **{f"sources.{SECOND}.use_heading": False},
    )
    errors, _ = errors_over(with_faults(measurements, faults, 0), recording, p)
    after = errors.between(135.0)
    assert after.rms < 0.05
    assert after.nees(2).mean() < 8.0
