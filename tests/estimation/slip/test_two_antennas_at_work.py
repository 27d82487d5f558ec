# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Positions with headings fail for a while on a site, where a machine turns on the spot and reverses.

A wrong heading is no reason to doubt the position of the same fix, nor the gyro.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest
from fixtures.drawn_machine import GNSS, Recording, parameters
from fixtures.fault_cases.case import seconds
from fixtures.pose_errors import PoseErrors, errors_over
from fixtures.short_moves import RATE, work

from trackslip_common.arrays import FloatArray
from trackslip_estimation.slip.measurements import Measurement, PoseFix

BEGIN, END = 40.0, 70.0  # s, of the fault
HEADING_STDDEV = 0.02  # rad
MOUNTED = [0.0, 0.02]  # rad, of the yaw offset

Fault = Callable[[FloatArray, FloatArray], FloatArray]  # pose, and that when the fault began → wrong pose


def with_headings(
    recording: Recording, seed: int, fault: Fault, begin: float = BEGIN, end: float = END
) -> list[Measurement]:
    """The drive with a heading in each fix, which ``fault`` changes from ``begin`` to ``end`` s."""
    noise, first = np.random.default_rng(seed + 100), np.zeros(3)
    changed: list[Measurement] = []
    for m in recording.measurements:
        if isinstance(m, PoseFix):
            heading = recording.poses[round(seconds(m) * RATE), 2] + HEADING_STDDEV * noise.normal()
            pose = np.array((*m.pose[:2], heading))
            if begin <= seconds(m) < end:
                first = first if first.any() else pose
                pose = fault(pose, first)
            pose[2] = math.remainder(pose[2], math.tau)
            covariance = np.diag((*np.diag(m.covariance)[:2], HEADING_STDDEV**2))
            m = PoseFix(m.source, m.stamp_ns, pose, covariance)
        changed.append(m)
    return changed


def errors_with(
    fault: Fault, mounted: float, seed: int, begin: float = BEGIN, end: float = END
) -> PoseErrors:
    recording = work(seed)
    sources = {"sources.box_pose.use_heading": True, "sources.box_pose.yaw_offset_stddev": mounted}
    measurements = with_headings(recording, seed, fault, begin, end)
    return errors_over(measurements, recording, parameters(**{**GNSS, **sources}))[0]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("mounted", MOUNTED)
@pytest.mark.parametrize(
    "off", [(0.0, 0.0, 0.5), (0.0, 0.0, math.pi), (0.6, 0.8, 0.5)], ids=["turned", "reversed", "both off"]
)
def test_wrong_headings_turn_neither_heading_nor_position(
    off: tuple[float, float, float], mounted: float, seed: int
) -> None:
    found = errors_with(lambda pose, _: pose + np.array(off), mounted, seed).between(10.0)
    assert found.heading_nees < 3.0
    assert found.inconsistent < 0.06
    if off[0] == 0.0:
        assert found.rms < 0.03


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("mounted", MOUNTED)
def test_a_frozen_heading_turns_neither_heading_nor_position(mounted: float, seed: int) -> None:
    found = errors_with(lambda pose, first: np.array((*pose[:2], first[2])), mounted, seed).between(10.0)
    assert np.abs(found.off[:, 2]).max() < 0.1
    assert found.inconsistent < 0.06
    assert found.rms < 0.03


@pytest.mark.parametrize("seed", range(4))
def test_an_offset_of_positions_is_still_one_when_the_slip_changes(seed: int) -> None:
    found = errors_with(lambda pose, _: pose + np.array((0.12, 0.16, 0.0)), 0.0, seed).between(10.0)
    assert found.nees(2).mean() < 5.0
    assert found.inconsistent < 0.1


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("east", [0.0, 1.0])
@pytest.mark.parametrize("mounted", MOUNTED)
def test_a_start_with_wrong_headings_is_corrected_while_the_machine_drives(
    mounted: float, east: float, seed: int
) -> None:
    off = np.array((east, 0.0, 0.5))
    found = errors_with(lambda pose, _: pose + off, mounted, seed, 0.0, 20.0).between(80.0)
    assert np.abs(found.off[:, 2]).max() < 0.1
    assert found.rms < 0.1
