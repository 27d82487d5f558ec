# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Wrong headings, of their own source or in poses, do not override fixes."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from fixtures.drawn_machine import GNSS, Machine, Recording, drive, parameters
from fixtures.pose_errors import PoseErrors, errors_over

from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.events import Event
from trackslip_estimation.slip.measurements import HeadingFix, Measurement, PoseFix
from trackslip_estimation.slip.parameters import SlipEstimatorParameters

Error = Callable[[float, float], float]  # error, rad, of a heading, rad, at a time, s

S = 1_000_000_000
STDDEV = 0.01
BEGIN, END = 40.0, 80.0
ALONE, IN_POSES = "compass", "box_pose"


def for_a_while(error: Callable[[float], float], until: float = END) -> Error:
    """An error from ``BEGIN`` to ``until``."""
    return lambda t, _: error(t - BEGIN) if BEGIN <= t < until else 0.0


ERRORS: Mapping[str, Error] = {
    "turned on the machine by 6°": lambda t, heading: 0.1,
    "iron beside it, 3°": lambda t, heading: 0.05 * math.sin(heading + 1.0),
    "off by 30° for 10 s": for_a_while(lambda t: 0.5, 50.0),
    "off by 6° for 40 s": for_a_while(lambda t: 0.1),
    "drifts by 1° a second": for_a_while(lambda t: 0.0175 * t, 60.0),
    "swings by 10°": for_a_while(lambda t: 0.175 * math.sin(t / 5.0)),
}


def seen(
    error: Error, source: str, seed: int, every: int = 2, stddev: float = STDDEV
) -> tuple[Recording, list[Measurement]]:
    """A drive with wrong headings: of a compass at each ``every``-th 50 ms, or in each fix."""
    recorded = drive(Machine(duration=120.0, seed=seed))
    noise, t = np.random.default_rng(seed + 50), recorded.t
    stamps = (S + np.round(t * S)).astype(np.int64)

    def shown(k: int) -> float:
        heading = float(recorded.poses[k, 2])
        return math.remainder(heading + error(float(t[k]), heading) + stddev * noise.normal(), math.tau)

    measurements: list[Measurement] = []
    for m in recorded.measurements:
        if isinstance(m, PoseFix) and source == IN_POSES:
            heading, covariance = shown(int(np.searchsorted(stamps, m.stamp_ns))), m.covariance.copy()
            covariance[2, :2] = covariance[:2, 2] = 0.0
            covariance[2, 2] = stddev**2
            m = PoseFix(m.source, m.stamp_ns, np.array((*m.pose[:2], heading)), covariance)
        measurements.append(m)
    if source == ALONE:
        readings = range(0, t.size, every)
        measurements += [HeadingFix(ALONE, int(stamps[k]), shown(k), stddev**2) for k in readings]
    return recorded, sorted(measurements, key=lambda m: m.stamp_ns)


def with_headings(source: str) -> SlipEstimatorParameters:
    values: dict[str, object] = {**GNSS, "sources.box_pose.yaw_offset_stddev": 0.02}
    values["sources.box_pose.use_heading"] = source == IN_POSES
    values["heading_sources"] = [ALONE] if source == ALONE else []
    return parameters(**values)


class Errors(NamedTuple):
    """RMS errors and NEES of the estimates after 20 s of some drives."""

    place: float  # m
    heading: float  # rad
    nees: float  # of the pose, 3 if consistent


def found_of(recorded: Recording, measurements: Sequence[Measurement], source: str) -> PoseErrors:
    return errors_over(measurements, recorded, with_headings(source))[0]


def errors_of(drives: Sequence[tuple[Recording, list[Measurement]]], source: str) -> Errors:
    found = [found_of(recorded, measurements, source).between(20.0) for recorded, measurements in drives]
    return Errors(
        math.sqrt(np.mean([e.rms**2 for e in found])),
        math.sqrt(np.mean([e.heading_rms**2 for e in found])),
        float(np.mean([e.nees(3).mean() for e in found])),
    )


@pytest.mark.parametrize("source", [ALONE, pytest.param(IN_POSES, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", ERRORS)
def test_wrong_headings_do_not_degrade_fixes(kind: str, source: str) -> None:
    found = errors_of([seen(ERRORS[kind], source, seed) for seed in range(2)], source)
    assert found.place < 0.06
    assert found.heading < 0.06
    assert found.nees < 6.0


@pytest.mark.parametrize(
    "kind", [pytest.param("off by 6° for 40 s", marks=pytest.mark.slow), "swings by 10°"]
)
def test_consistent_wrong_headings_do_not_outvote_fixes(kind: str) -> None:
    """A compass at 20 Hz has less noise than error."""
    found = errors_of([seen(ERRORS[kind], ALONE, seed, every=1, stddev=0.005) for seed in range(2)], ALONE)
    assert found.place < 0.03
    assert found.heading < 0.03
    assert found.nees < 9.0


@pytest.mark.parametrize("turned", [pytest.param(0.1, marks=pytest.mark.slow), 0.5])
def test_multipath_is_rejected_while_headings_are_off(turned: float) -> None:
    """A metre of multipath for 8 s; the receiver's antenna pair is rotated on the machine."""
    squares, nees = [], []
    for seed in range(3):
        truth, measurements = seen(lambda t, heading: turned if t > 20.0 else 0.0, IN_POSES, seed)
        for k, m in enumerate(measurements):
            if isinstance(m, PoseFix) and 61 * S <= m.stamp_ns < 69 * S:
                measurements[k] = replace(m, pose=m.pose + np.array((0.8, 0.6, 0.0)))
        found = found_of(truth, measurements, IN_POSES).between(60.0, 75.0)
        squares.append(found.rms**2)
        nees.append(found.nees(2).mean())
    assert math.sqrt(np.mean(squares)) < 0.2
    assert np.mean(nees) < 5.0  # 2 if consistent


def shifted(measurements: Sequence[Measurement], by: Mapping[int, tuple[float, float]]) -> list[Measurement]:
    """The measurements with some fixes, by their number, displaced."""
    fixes = (k for k, m in enumerate(measurements) if isinstance(m, PoseFix))
    places = {k: by[n] for n, k in enumerate(fixes) if n in by}
    return [
        replace(m, pose=m.pose + np.array((*places[k], 0.0))) if isinstance(m, PoseFix) and k in places else m
        for k, m in enumerate(measurements)
    ]


def largest_error(truth: Recording, measurements: Sequence[Measurement], source: str, since: float) -> float:
    """Largest position error from ``since`` s on, m."""
    return float(found_of(truth, measurements, source).between(since).distances.max())


def test_first_fix_that_is_an_outlier_is_dropped_while_headings_agree() -> None:
    truth, measurements = seen(lambda t, heading: 0.0, ALONE, 0)
    assert largest_error(truth, shifted(measurements, {0: (-5.0, 1.0)}), ALONE, 5.0) < 0.1


def test_first_fix_wrong_in_position_and_heading_is_dropped_as_a_whole() -> None:
    truth, measurements = seen(lambda t, heading: 0.5 if t < 0.4 else 0.0, IN_POSES, 0)
    found = errors_of([(truth, shifted(measurements, {0: (-5.0, 1.0)}))], IN_POSES)
    assert found.place < 0.1
    assert found.heading < 0.02
    assert found.nees < 6.0


def test_consecutive_outliers_with_right_headings_do_not_move_the_estimate() -> None:
    truth, measurements = seen(lambda t, heading: 0.0, IN_POSES, 0)
    spoilt = shifted(measurements, {120: (1.0, 5.0), 121: (-2.0, -7.0), 122: (0.7, 0.3)})
    assert largest_error(truth, spoilt, IN_POSES, 20.0) < 0.2


def test_mostly_wrong_positions_with_right_headings_do_not_move_the_estimate() -> None:
    random = np.random.default_rng(7)
    truth, measurements = seen(lambda t, heading: 0.0, IN_POSES, 0)
    wrong = {k: tuple(random.normal(0.0, 3.0, 2).tolist()) for k in range(100, 140) if random.random() < 0.6}
    spoilt = shifted(measurements, wrong)
    assert len(wrong) > 15
    assert largest_error(truth, spoilt, IN_POSES, 20.0) < 0.3


@pytest.mark.parametrize("source", [ALONE, IN_POSES])
def test_heading_as_stated_causes_no_event(source: str) -> None:
    _, measurements = seen(lambda t, heading: 0.0, source, 3)
    estimator = SlipEstimator(with_headings(source))
    estimator.process_all(measurements)
    assert not {e.event for e in estimator.read_events()} & {Event.HEADING_OFF, Event.HEADING_WANDERS}


@pytest.mark.parametrize("source", [ALONE, IN_POSES])
def test_the_source_of_a_heading_that_is_off_is_named(source: str) -> None:
    _, measurements = seen(ERRORS["off by 30° for 10 s"], source, 1)
    estimator, texts = SlipEstimator(with_headings(source)), []
    for m in measurements:
        estimator.process(m)
        if abs(m.stamp_ns - 46 * S) < S // 50:
            texts = [e.text for e in estimator.competing_explanations.explanations]
    assert any(text.startswith(f"{source} is ") and text.endswith(" ° off") for text in texts)
