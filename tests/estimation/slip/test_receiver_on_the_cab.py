# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The upper structure swings, with a GNSS receiver on it: at standstill, in motion, and unseen."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from fixtures.changes import changed
from fixtures.drawn_machine import GNSS
from fixtures.pose_errors import errors_over
from fixtures.swinging_cab import COMPASS, Cab, Part, cab_headings, dig, record

from trackslip_common.arrays import FloatArray
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.events import Event
from trackslip_estimation.slip.measurements import Measurement, Outcome, PoseFix, Sprockets
from trackslip_estimation.slip.parameters import load_slip_parameters

WITH_COMPASS = {"vehicle": "pc05_cab", "heading_sources": [COMPASS], f"sources.{COMPASS}.offset": 0.0}
WITHOUT_ENCODER = {"vehicle": "pc05_cab", "swing_sources": [""]}
RECEIVERS: Mapping[str, Mapping[str, float | bool]] = {
    "two antennas": {"sources.box_pose.yaw_offset_stddev": 0.02},
    "one antenna": {"sources.box_pose.use_heading": False, "initial_yaw_stddev": 0.02},
}
BEFORE = [Part(2.0), Part(6.0, swing_to=2.0), Part(10.0, 2.0, 2.0), Part(6.0, 1.2, 2.2)]
AFTER = [Part(8.0, 2.0, 2.0), Part(6.0, 1.2, 2.2), Part(8.0, 2.0, 2.0)]
SWINGS: Mapping[str, Sequence[Part]] = {
    "on a straight": [Part(8.0, 2.0, 2.0, swing_to=-1.0)],
    "by half a radian": [Part(3.0, 2.0, 2.0, swing_to=1.5)],
    "in a turn": [Part(6.0, 1.2, 2.2, swing_to=0.0)],
    "against a turn": [Part(6.0, 2.2, 1.2, swing_to=2.9)],
    "in reverse": [Part(2.0), Part(8.0, -2.0, -2.0, swing_to=-1.0)],
}


@pytest.mark.parametrize("fix_hertz", [5.0, 1.0])
@pytest.mark.parametrize("receiver", RECEIVERS)
@pytest.mark.parametrize("swing", SWINGS)
def test_swing_while_the_tracks_drive_turns_neither_undercarriage_nor_path(
    swing: str, receiver: str, fix_hertz: float
) -> None:
    drive = record([*BEFORE, *SWINGS[swing], *AFTER], Cab(fix_hertz=fix_hertz, encoder=False))
    parameters = load_slip_parameters(WITHOUT_ENCODER, GNSS, RECEIVERS[receiver])
    found, estimator = errors_over(drive.measurements, drive, parameters)
    found = found.between(24.0)
    assert found.rms < 0.03
    assert np.abs(found.off[:, 2]).max() < 0.3
    assert found.nees(2).mean() < 4.0
    assert found.heading_nees < 3.0
    assert Event.FAILED in {e.event for e in estimator.read_events() if e.source == "swing brake"}


def with_correlated_errors(measurements: Iterable[Measurement], seed: int) -> list[Measurement]:
    """The measurements with errors of their positions of 1 cm, with a correlation time of 5 s."""
    random, error, last_ns, changed = np.random.default_rng(seed), np.zeros(2), 0, list[Measurement]()
    for m in measurements:
        if isinstance(m, PoseFix):
            decay, last_ns = math.exp(-(m.stamp_ns - last_ns) * 1e-9 / 5.0), m.stamp_ns
            error = decay * error + math.sqrt(1.0 - decay**2) * 0.01 * random.standard_normal(2)
            off: FloatArray = np.array((*error, 0.0))
            m = replace(m, pose=m.pose + off, covariance=m.covariance + np.diag((1e-4, 1e-4, 0.0)))
        changed.append(m)
    return changed


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("receiver", RECEIVERS)
def test_time_correlated_errors_of_a_receiver_on_the_cab_are_no_events(receiver: str, seed: int) -> None:
    drive = record([*dig(), *dig(-math.pi), *dig()], Cab(fix_hertz=10.0, seed=seed))
    estimator = SlipEstimator(load_slip_parameters({"vehicle": "pc05_cab"}, GNSS, RECEIVERS[receiver]))
    steps = estimator.process_all(with_correlated_errors(drive.measurements, seed))
    assert estimator.read_events() == []
    fixes = [report for report, _ in steps if report.source == "box_pose"]
    assert sum(fix.outcome is Outcome.GATED for fix in fixes) <= 0.01 * len(fixes)


SILENT = [
    Part(6.0, swing_to=-1.0),
    Part(8.0, 1.5, 2.5),
    Part(6.0, swing_to=1.5),
    Part(8.0, -2.0, -2.0),
    Part(9.0),
]
SILENCE = 27.0, 62.0  # s, of stamps


@pytest.mark.parametrize("fix_hertz", [5.0, 1.0])
@pytest.mark.parametrize("gyro", [True, False])
def test_cab_that_swung_while_the_sprockets_were_silent_is_found_again(
    *, gyro: bool, fix_hertz: float
) -> None:
    """Without an encoder neither heading nor swing angle is known after the silence."""
    drive = record(
        [*BEFORE, Part(2.0), *SILENT, *AFTER, *AFTER], Cab(fix_hertz=fix_hertz, encoder=False, gyro=gyro)
    )
    measurements = changed(drive.measurements, Sprockets, lambda _: None, *SILENCE)
    found, _ = errors_over(
        measurements, drive, load_slip_parameters(WITHOUT_ENCODER, GNSS, RECEIVERS["one antenna"])
    )
    assert found.between(20.0).nees(2).mean() < 4.0
    after = found.between(75.0)
    assert after.rms < 0.3
    assert np.abs(after.off[:, 2]).max() < 0.5


@pytest.mark.parametrize("swing", [0.0, 2.0])
def test_compass_on_the_cab_corrects_a_wrong_initial_heading(swing: float) -> None:
    drive = record([Part(6.0), Part(20.0, 2.0, 2.0)], Cab(start=swing))
    compass = [m for m in cab_headings(drive, 20.0) if m.stamp_ns >= 3 * 10**9]
    parameters = load_slip_parameters(
        WITH_COMPASS,
        {"start": "initial_pose", "initial_yaw": 1.2, "sources.box_pose.use_heading": False, **GNSS},
    )
    measurements = sorted([*drive.measurements, *compass], key=lambda m: m.stamp_ns)
    found, _ = errors_over(measurements, drive, parameters)
    assert np.abs(found.between(8.0).off[:, 2]).max() < 0.1


def test_explanation_of_a_swing_in_motion_ends_with_the_motion() -> None:
    drive = record([*BEFORE, *SWINGS["on a straight"], Part(5.0)], Cab(encoder=False))
    _, estimator = errors_over(
        drive.measurements, drive, load_slip_parameters(WITHOUT_ENCODER, GNSS, RECEIVERS["one antenna"])
    )
    assert Event.FAILED in {e.event for e in estimator.read_events()}
    assert "swings" not in estimator.competing_explanations.text
