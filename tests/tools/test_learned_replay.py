# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A replay reports the learned states, and starts from those of the live estimator."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.recorded import in_order_of_journal, write_lines

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.messages import make
from trackslip_bags.parameters import PARAMETERS_TOPIC, PARAMETERS_TYPE
from trackslip_bags.reader import open_bag
from trackslip_common.config_files import parameters_text
from trackslip_common.parameters import to_flat
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.learned import to_tree
from trackslip_estimation.slip.parameters import NODE, load_slip_parameters
from trackslip_tools.replay.run import replay
from trackslip_tools.report.panels import learned_panels
from trackslip_tools.report.run import Run
from trackslip_tools.report.tables import learned_rows

Summary = Callable[..., dict[str, Any]]


@pytest.fixture(scope="module")
def learned_tree(drive: Callable[..., Any]) -> dict[str, Any]:
    """Learned states of an earlier run, on ground without slip."""
    p = load_slip_parameters()
    estimator = SlipEstimator(p)
    segments = [(5.0, 2.0, 2.0, 0.0, 0.0, 0.0), (5.0, 1.0, 2.0, 0.0, 0.0, 0.0)]
    estimator.process_all(drive(segments, seed=4, gyro_bias=0.004).measurements)
    assert estimator.learned is not None
    return to_tree(estimator.learned, estimator.learned_context)


@pytest.fixture
def second_run(
    bag_of: Callable[..., Path], lines: list[Any], learned_tree: dict[str, Any]
) -> Callable[..., Path]:
    """A function that writes a bag of a run that started from these learned states."""

    def make_bag(learned: object = learned_tree) -> Path:
        text = parameters_text(to_flat(load_slip_parameters()), NODE, learned=learned)
        parameters = lines[0].instead(PARAMETERS_TOPIC, make(PARAMETERS_TYPE, data=text))
        first_ns = min(line.log_ns for line in lines)
        return bag_of([parameters._replace(log_ns=first_ns - 1), *lines])

    return make_bag


def test_replay_reports_learned_states(
    bag: Path, summary: Summary, capsys: pytest.CaptureFixture[str]
) -> None:
    result = summary(bag)["learned"]
    assert {"gyro_scale", "asymmetry", "fix_delay.box_pose", "track_error"} <= result.keys()
    assert {"gyro_noise_factor", "fix_noise_factor.box_pose"} <= result.keys()
    assert all(entry.keys() == {"value", "stddev", "observed"} for entry in result.values())
    assert result["track_error"]["observed"] is True
    assert result["fix_delay.box_pose"]["observed"] is False
    shown = capsys.readouterr().out
    assert "learned values" in shown
    assert "tracks err by " in shown
    assert "not observed yet: " in shown


def test_replay_starts_from_the_learned_states_of_the_live_estimator(
    second_run: Callable[..., Path],
    bag: Path,
    summary: Summary,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = second_run()
    result = summary(path)
    assert "starts from values learned before the bag begins" in capsys.readouterr().out
    assert result["final"] != summary(bag)["final"]
    with open_bag(path) as second:
        replayed = replay(second, load_slip_parameters(), InputFilters(), None)
    assert len(replayed.learned) > 1
    assert replayed.estimates[-1]["pose"].tolist() == [result["final"][n] for n in ("x", "y", "yaw")]


def test_bag_of_a_replay_has_the_learned_states_of_its_start(
    second_run: Callable[..., Path], tmp_path: Path, lines: list[Any], summary: Summary
) -> None:
    made, both = tmp_path / "made", tmp_path / "both"
    summary(second_run(), "--output", made)
    assert summary(write_lines(both, lines, in_order_of_journal(made)))["replay_matches"] is True


@pytest.mark.parametrize(
    ("learned", "options", "reason"),
    [
        (None, ("--set", "slip_estimator.vehicle.kinematics.tread=0.8"), "of another vehicle"),
        (3, (), "contains no learned values"),
        ({"machine": "x"}, (), "of another vehicle"),
    ],
)
def test_unusable_learned_states_are_reported_and_not_used(
    second_run: Callable[..., Path],
    summary: Summary,
    printed: Callable[[], str],
    learned: object,
    options: tuple[str, ...],
    reason: str,
) -> None:
    summary(second_run(learned) if learned else second_run(), *options)
    shown = printed()
    assert "learned values from before" in shown
    assert reason in shown


def test_report_shows_learned_states_over_time(emulated_run: Run) -> None:
    rows = {row[0]: row for row in learned_rows(emulated_run)}
    assert rows["gyro bias"][3] == "°/s"
    assert rows["delay of box_pose"][1:3] == ("–", "–")
    assert "…" in rows["turning efficiency κ"][2]
    assert not rows["track error"][2].startswith(("-", "−"))  # the value is unsigned
    panels = {panel.title: panel for panel in learned_panels([emulated_run])}
    (curve,) = panels["track error"].curves
    assert curve.band is not None
    assert curve.band[0].min() >= 0.0
    (curve,) = panels["turning efficiency κ"].curves
    assert curve.band is not None
    width = curve.band[1] - curve.band[0]
    assert width[-1] < width[0] / 2.0
    assert np.all(np.diff(curve.times) > 0.0)
    assert len(curve.times) == len(emulated_run.replay.learned)
