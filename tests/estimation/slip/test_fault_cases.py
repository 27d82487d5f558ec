# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Drives with injected faults, compared with a baseline; ``make cases`` prints all scores.

Tests marked ``slow`` run every case. The others run some of them, and check the scores.
"""

from collections.abc import Mapping
from dataclasses import replace

import pytest
from fixtures.drawn_machine import Machine, drive
from fixtures.fault_cases.bars import Bar, bars, geometric_mean, of_group
from fixtures.fault_cases.case import GNSS, SECOND, Group, seconds
from fixtures.fault_cases.catalogue import CATALOGUE
from fixtures.fault_cases.drawn_cases import with_source
from fixtures.fault_cases.injections import INJECTIONS
from fixtures.fault_cases.robot_cases import injected_case
from fixtures.fault_cases.robot_logs import Compass, is_present
from fixtures.fault_cases.running import (
    BASELINE,
    named_cases,
    read_scores,
    score_cases,
    score_named,
)
from fixtures.fault_cases.scoring import Score
from fixtures.fault_cases.scoring import score as score_case
from fixtures.fault_cases.sensor_faults import SENSOR_FAULTS
from fixtures.fault_cases.sweep import COMPASSES, Setting, sweep

from trackslip_estimation.slip.measurements import Measurement
from trackslip_estimation.slip.records import to_records

EVENT = 20.0  # s
EVERY = 4  # of the times of a sweep
TWO_ANTENNAS, COMPASS = COMPASSES
CLEAN = ("no harm: track error 5%, seed 0", "no harm: gyro scale 1.03, seed 0")
GROSS = (
    "drawn: all scattered from 29 s",
    "drawn: silence, then one wrong fix",
)

slow = [pytest.mark.slow, pytest.mark.timeout(3600)]


@pytest.fixture(scope="module")
def baseline() -> dict[str, Score]:
    return read_scores(BASELINE)


@pytest.fixture(scope="module")
def drawn() -> list[Measurement]:
    recording = drive(Machine(duration=40.0, fix_noise=0.03, fix_stated=0.03))
    return with_source(recording.measurements, GNSS)


def same_records(given: list[Measurement], other: list[Measurement]) -> bool:
    sources = {GNSS: 0, SECOND: 1, "imu/data_raw": 2}
    return to_records(given, sources).tobytes() == to_records(other, sources).tobytes()


def test_baseline_has_a_score_of_every_case(baseline: dict[str, Score]) -> None:
    assert list(baseline) == list(CATALOGUE)


@pytest.mark.parametrize("name", [*INJECTIONS, *SENSOR_FAULTS])
def test_injection_leaves_what_precedes_its_event(name: str, drawn: list[Measurement]) -> None:
    injected = {**INJECTIONS, **SENSOR_FAULTS}[name].inject(drawn, EVENT, 0.03)
    begin = injected.window[0]
    of_first = [m for m in injected.measurements if m.source != SECOND]
    before, after = ([m for m in ms if seconds(m) < begin] for ms in (drawn, of_first))
    assert same_records(before, after)
    assert not same_records(drawn, injected.measurements)
    assert [m.stamp_ns for m in injected.measurements] == sorted(m.stamp_ns for m in injected.measurements)


def test_bars_compare_with_the_baseline_by_ratios(baseline: dict[str, Score]) -> None:
    doubled = {name: replace(score, rmse=2.0 * score.rmse) for name, score in baseline.items()}
    found = bars(doubled, baseline)
    for key in ("multipath", "other", "worst", "worst_jump", "worst_clean", "correlated", "worst_white"):
        assert found[key].value == pytest.approx(2.0), key
    assert not found["worst"].is_met
    assert geometric_mean((0.5, 2.0)) == pytest.approx(1.0)


@pytest.mark.parametrize("name", CLEAN)
def test_drive_without_faults_is_within_a_hundredth_of_the_baseline(
    name: str, baseline: dict[str, Score]
) -> None:
    score = score_named(name)
    assert score.rmse <= 1.01 * baseline[name].rmse
    assert score.gated == 0
    assert score.live_equals_replay


@pytest.mark.parametrize("name", GROSS)
def test_gross_outliers_are_rejected(name: str, baseline: dict[str, Score]) -> None:
    score = score_named(name)
    assert score.rmse <= 1.5 * baseline[name].rmse
    assert score.inconsistent <= 0.06
    assert score.leaps == 0
    assert score.live_equals_replay


def test_unknown_heading_is_found(baseline: dict[str, Score]) -> None:
    name = "drawn: heading unknown, outliers 20%"
    score = score_named(name)
    assert score.rmse <= 1.5 * baseline[name].rmse
    assert score.inconsistent <= 0.06
    assert score.live_equals_replay


@pytest.fixture(scope="module")
def scores() -> dict[str, Score]:
    """Scores of all cases whose log is present."""
    return dict(score_cases(named_cases(), jobs=2))


@pytest.fixture(scope="module")
def found(scores: dict[str, Score], baseline: dict[str, Score]) -> Mapping[str, Bar]:
    return bars(scores, baseline)


@pytest.mark.skipif(not is_present("marmotte"), reason="no log of the tracked robot")
@pytest.mark.parametrize(
    ("rate", "fault", "rmse", "largest"),
    [
        (1.0, "both encoders show 0 10 s", 0.3, 0.6),
        (5.0, "left encoder frozen 10 s", 0.1, 0.2),
    ],
)
def test_fault_is_found_at_each_time_of_a_real_drive(
    rate: float, fault: str, rmse: float, largest: float
) -> None:
    cell = sweep(Setting("marmotte", rate, fault), EVERY)
    assert cell.median_rmse < rmse
    assert max(s.rmse for s in cell.scores.values()) < largest
    assert cell.inconsistent < 0.08


@pytest.mark.skipif(not is_present("marmotte"), reason="no log of the tracked robot")
@pytest.mark.parametrize(("event", "fault"), [(50.0, "multipath 1.0 m 10 s"), (62.0, "multipath 0.5 m 10 s")])
def test_end_of_multipath_confirms_an_improbable_offset(event: float, fault: str) -> None:
    """A slow receiver moves an uncertain machine; the offset stays improbable until it ends."""
    case = injected_case("marmotte", event, INJECTIONS[fault])
    found = score_case(replace(case, window=(event + 13.0, event + 30.0)))
    assert found.rmse < 0.15
    assert found.nees < 4.0


@pytest.mark.skipif(not is_present("marmotte"), reason="no log of the tracked robot")
def test_rejected_yaw_rates_show_at_once_that_the_tracks_are_swapped() -> None:
    assert sweep(Setting("marmotte", 1.0, "tracks swapped 3 s"), EVERY).inconsistent < 0.02


@pytest.mark.parametrize(
    ("robot", "fault", "compass"),
    [
        ("warthog", "gyro reversed 15 s", TWO_ANTENNAS),
        pytest.param("warthog", "gyro shows 0 15 s", COMPASS, marks=pytest.mark.slow),
        ("marmotte", "right encoder reversed 10 s", TWO_ANTENNAS),
    ],
)
def test_fault_beside_headings_is_found_at_each_time_of_a_real_drive(
    robot: str, fault: str, compass: Compass
) -> None:
    if not is_present(robot):
        pytest.skip("no log of the robot")
    cell = sweep(Setting(robot, 5.0, fault, compass), EVERY)
    assert cell.median_rmse < 0.12
    assert max(s.rmse for s in cell.scores.values()) < 0.25
    assert cell.inconsistent < 0.04


@pytest.mark.skipif(not is_present("warthog"), reason="no log of the wheeled robot")
@pytest.mark.parametrize("compass", [None, pytest.param(TWO_ANTENNAS, marks=pytest.mark.slow)])
def test_failed_encoders_are_found_without_a_gyro(compass: Compass | None) -> None:
    """A fast machine keeps its speed while its encoders fail."""
    cell = sweep(Setting("warthog", 5.0, "both encoders show 0 10 s", compass, has_gyro=False), EVERY)
    assert cell.median_rmse < 0.16
    assert max(s.rmse for s in cell.scores.values()) < 0.25
    assert cell.inconsistent < 0.06


EVERY_CASE: dict[str, tuple[str, ...]] = {  # promise → keys of the bars over all cases
    "multipath and frozen fixes keep a seventh of the error": ("multipath",),
    "other faults keep two thirds of the error": ("other",),
    "no case but a permanent jump is worse by half": ("worst", "heavy_tails"),
    "permanent jumps cost three times at most": ("worst_jump",),
    "truth stays inside three sigma at permanent jumps": ("jumps_outside",),
    **{
        f"covariances hold in the windows of events: {machine}": (f"inconsistent_{machine}",)
        for machine in ("drawn", "marmotte", "warthog")
    },
    "Gaussian fixes without faults stay within a hundredth": ("clean", "worst_clean"),
    "correlated errors of fixes cost a tenth less": ("correlated",),
    "white errors as stated cost three hundredths at most": ("white", "worst_white"),
    "estimates are consistent with every receiver": (
        *("receiver_nees", "receiver_heading_nees", "outage_nees"),
    ),
    "an ordinary receiver on a mower moves neither heading nor slip": (
        *("mower_position", "mower_heading", "mower_slip"),
    ),
    "covariances hold with an ordinary receiver on a mower": ("mower_nees", "mower_heading_nees"),
    "outages of an ordinary receiver are bridged": ("outages", "outages_nees", "single_outages"),
    "RTK on a mower stays exact": ("rtk_1_hz", "rtk_5_hz"),
    "RTK on a mower never reverses the heading": ("rtk_heading",),
    "gyro carries the heading over encoder gaps": ("gaps_heading",),
    "covariances hold over encoder gaps": ("gaps_nees",),
}


class TestEveryCase:
    """Bars over all cases."""

    pytestmark = slow

    @pytest.mark.parametrize("promise", EVERY_CASE)
    def test_bars_over_all_cases_are_met(self, found: Mapping[str, Bar], promise: str) -> None:
        present = [found[key] for key in EVERY_CASE[promise] if key in found]
        if not present:
            pytest.skip("no log of the cases")
        assert [bar for bar in present if not bar.is_met] == []

    def test_live_equals_replay_in_every_case(self, scores: dict[str, Score]) -> None:
        assert [name for name, score in scores.items() if not score.live_equals_replay] == []

    def test_no_fix_is_rejected_without_a_fault(self, scores: dict[str, Score]) -> None:
        assert {name: s.gated for name, s in of_group(scores, Group.CLEAN).items() if s.gated} == {}
