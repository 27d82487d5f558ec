# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A wrong swing encoder does not override fixes and gyro on the cab."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from fixtures.drawn_machine import GNSS
from fixtures.pose_errors import PoseErrors, errors_over
from fixtures.swinging_cab import COMPASS, ENCODER, Cab, Part, Recording, cab_headings, dig, record

from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.events import Event
from trackslip_estimation.slip.measurements import Measurement, Outcome, SwingAngle
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, load_slip_parameters

S = 1_000_000_000
BEGIN, END = 60.0, 85.0
EncoderFault = Callable[[float, float, float], float]  # of t, s, the true angle and that at BEGIN, rad

FAULTS: Mapping[str, EncoderFault] = {
    "frozen for 25 s": lambda t, angle, at_begin: at_begin if BEGIN <= t < END else angle,
    "slipped on its ring by 10°": lambda t, angle, _: angle + (0.175 if t >= BEGIN else 0.0),
    "slipped on its ring by 90°": lambda t, angle, _: angle + (1.571 if t >= BEGIN else 0.0),
    "shows zero": lambda t, angle, _: 0.0,
    "counts backwards": lambda t, angle, _: -angle,
}


def of_receiver(*, has_heading: bool = True) -> SlipEstimatorParameters:
    """Parameters of a cab with encoder and gyro, and a receiver of precise positions, and maybe headings."""
    of_fixes = {"sources.box_pose.use_heading": has_heading, "initial_yaw_stddev": 0.02}
    return load_slip_parameters({"vehicle": "pc05_cab"}, GNSS, {} if has_heading else of_fixes)


def spoilt(recording: Recording, fault: EncoderFault) -> list[Measurement]:
    """The measurements with encoder angles from the function ``fault``."""
    measurements, at_begin = list(recording.measurements), math.nan
    for k, m in enumerate(measurements):
        if isinstance(m, SwingAngle):
            t = m.stamp_ns / S - 1.0
            if math.isnan(at_begin) and t >= BEGIN:
                at_begin = m.angle
            measurements[k] = replace(m, angle=math.remainder(fault(t, m.angle, at_begin), math.tau))
    return measurements


def errors_of(
    recording: Recording, measurements: Sequence[Measurement], *, has_heading: bool = True
) -> PoseErrors:
    """Errors of the estimates after 20 s."""
    found, _ = errors_over(measurements, recording, of_receiver(has_heading=has_heading))
    return found.between(20.0)


@pytest.mark.parametrize("kind", FAULTS)
def test_wrong_swing_encoder_degrades_neither_position_nor_heading(kind: str) -> None:
    parts = [part for angle in (math.pi, math.pi / 2.0, -1.0) for part in dig(angle)]
    recording = record(parts, Cab(fix_hertz=1.0))
    found = errors_of(recording, spoilt(recording, FAULTS[kind]))
    assert found.rms < 0.02
    assert found.heading_rms < 0.02
    assert found.nees(2).mean() < 4.0
    assert found.heading_nees < 3.0


@pytest.mark.parametrize(("hertz", "has_heading"), [(20, True), (50, False)])
@pytest.mark.parametrize("fix_hertz", [5.0, 1.0])
def test_encoder_that_freezes_before_a_swing_does_not_turn_the_undercarriage(
    fix_hertz: float, hertz: int, has_heading: bool
) -> None:
    """The undercarriage may as well turn below a cab at rest, by sprockets that do not show it."""
    recording = record([*dig(), *dig(math.pi / 2.0)], Cab(hertz=hertz, fix_hertz=fix_hertz))
    measurements = spoilt(recording, lambda t, angle, _: 0.0 if 12.0 <= t < 30.0 else angle)
    found = errors_of(recording, measurements, has_heading=has_heading)
    assert found.rms < 0.02
    assert found.heading_rms < 0.03
    assert found.heading_nees < 3.0


def test_scale_error_of_a_tenth_turns_the_heading_by_at_most_a_tenth_of_the_swing() -> None:
    parts = [part for angle in (math.pi, math.pi / 2.0, -1.0) for part in dig(angle)]
    recording = record(parts, Cab(hertz=50))
    found = errors_of(recording, spoilt(recording, lambda t, angle, _: 0.9 * angle))
    assert found.heading_rms < math.pi / 10.0
    assert found.rms < 0.02


DRIVES_ON = [Part(2.0), Part(8.0, 2.0, 2.0)]
JUMPS = 7.5  # s


def test_a_spike_of_the_encoder_is_rejected() -> None:
    recording = record(DRIVES_ON, Cab())
    at = JUMPS + 0.01
    measurements = spoilt(recording, lambda t, angle, _: angle + (0.5 if at < t < at + 0.05 else 0.0))
    steps = SlipEstimator(of_receiver()).process_all(measurements)
    outcomes = [report.outcome for report, _ in steps if report.source == ENCODER]
    assert outcomes.count(Outcome.GATED) == 1


def test_angle_jump_at_a_still_cab_is_attributed_to_the_encoder() -> None:
    recording = record(DRIVES_ON, Cab())
    measurements = spoilt(recording, lambda t, angle, _: angle + (0.5 if t > JUMPS else 0.0))
    estimator = SlipEstimator(of_receiver())
    found = [e for _, e in estimator.process_all(measurements) if e is not None]
    angles = [e.outputs.swing.angle for e in found if e.outputs.swing is not None]
    assert abs(angles[-1]) < 0.02
    assert estimator.competing_explanations.number_competing == 1
    assert ENCODER in estimator.competing_explanations.text


def test_encoder_with_a_persistent_offset_is_used_again() -> None:
    recording = record(dig(), Cab())
    jumps = 30.0
    measurements = spoilt(recording, lambda t, angle, _: angle + (0.5 if t > jumps else 0.0))
    estimator = SlipEstimator(of_receiver())
    steps = estimator.process_all(measurements)
    outcomes = [report.outcome for report, _ in steps if report.source == ENCODER]
    assert set(outcomes[-20:]) == {Outcome.ACCEPTED}
    found = [e for _, e in steps if e is not None and e.outputs.swing is not None]
    true = np.interp(found[-1].stamp_ns / S - 1.0, recording.t, recording.swings[:, 0])
    assert found[-1].outputs.swing is not None
    assert abs(math.remainder(found[-1].outputs.swing.angle - float(true), math.tau)) < 0.02
    assert Event.BECAME_JUMP in {h.event for h in estimator.read_events()}
    assert Event.MOVED not in {h.event for h in estimator.read_events()}


@pytest.mark.parametrize("compass_hertz", [5.0, 1.0])
@pytest.mark.parametrize("seed", range(4))
def test_drift_of_the_encoder_beside_a_compass_on_the_cab_turns_no_undercarriage(
    seed: int, compass_hertz: float
) -> None:
    parts = [part for angle in (math.pi, math.pi / 2.0, -1.0) for part in dig(angle)]
    recording = record(parts, Cab(fix_hertz=1.0, seed=seed))
    measurements = spoilt(
        recording, lambda t, angle, _: angle + 0.02 * max(min(t, END) - BEGIN, 0.0) * (t < END)
    )
    compass = cab_headings(recording, compass_hertz, seed=seed)
    parameters = load_slip_parameters(
        {"vehicle": "pc05_cab", "heading_sources": [COMPASS], f"sources.{COMPASS}.offset": 0.0},
        {f"sources.{COMPASS}.yaw_offset_stddev": 0.02, "sources.box_pose.use_heading": False, **GNSS},
    )
    found, _ = errors_over(sorted([*measurements, *compass], key=lambda m: m.stamp_ns), recording, parameters)
    found = found.between(20.0)
    assert found.rms < 0.05
    assert found.heading_rms < 0.06
    assert found.heading_nees < 12.0
