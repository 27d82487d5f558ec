# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip report``: innovations and verdicts distinguish a consistent run from an inconsistent one."""

import dataclasses
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trackslip_bags.input_filters import InputFilters, Withhold
from trackslip_common.tally import Tally
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.records import POSE, RESULT, SPROCKETS
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_tools.replay.arrivals import ARRIVAL
from trackslip_tools.replay.comparison import LiveComparison
from trackslip_tools.replay.parts import Part
from trackslip_tools.replay.result import KEPT_ESTIMATE, Replay
from trackslip_tools.replay.soil import SoilReplay
from trackslip_tools.replay.withheld import WithholdResult
from trackslip_tools.report.details import Details
from trackslip_tools.report.innovations import innovation_panels, innovations_of, whitened_fixes
from trackslip_tools.report.panel import GREEN, Form
from trackslip_tools.report.recording import Timing
from trackslip_tools.report.run import Run
from trackslip_tools.report.tables import rejection_rows
from trackslip_tools.report.verdict import State, load_limits, verdicts

MS = 1_000_000


@pytest.fixture
def run(emulated_run: Run) -> Run:
    return emulated_run


def changed(run: Run, recording: dict[str, Any] | None = None, **replayed: Any) -> Run:
    """The run with other recorded or replayed results."""
    return dataclasses.replace(
        run,
        recording=dataclasses.replace(run.recording, **(recording or {})),
        replay=dataclasses.replace(run.replay, **replayed),
    )


# Innovations


def consistent_run(run: Run, factor: float = 1.0, size: int = 600) -> Run:
    """Fixes of a machine at rest; errors of fixes and poses are ``factor`` times as large as stated."""
    rng = np.random.default_rng(3)
    own, theirs = np.diag((0.02, 0.03, 0.01)), np.diag((0.05, 0.04, 0.02))
    sources, k = ("sprockets", "box_pose"), np.arange(size)
    arrivals, results = np.zeros((size, 4), ARRIVAL), np.zeros((size, 4), RESULT)
    arrivals["source"], arrivals["kind"] = (0, 0, 1, 1), (SPROCKETS, SPROCKETS, POSE, POSE)
    arrivals["stamp_ns"] = results["stamp_ns"] = k[:, np.newaxis] * 100 * MS + (0, 0, 0, 1)
    results["outcome"][:, 3] = Outcome.GATED
    results["dof"][:, 2:], results["gate"][:, 2:], results["nis"][:, :2] = 3, 21.1, np.nan
    results["nis"][:, 2], results["nis"][:, 3] = rng.chisquare(3, size) * factor**2, 500.0
    results["published"][:, 1] = True
    estimates = results["estimate"][:, 1]
    estimates["stamp_ns"], estimates["motion"] = k * 100 * MS, Motion.STRAIGHT
    estimates["pose"] = factor * rng.normal(size=(size, 3)) @ own + (1.0, 2.0, np.pi)
    estimates["pose_covariance"] = own @ own
    fixes = arrivals[:, 2]
    fixes["value"] = (1.0, 2.0, -np.pi) + factor * rng.normal(size=(size, 3)) @ theirs
    fixes["noise"] = theirs @ theirs
    details = Details()
    details.add(Part(sources, arrivals.ravel(), results.ravel(), {}, []))
    published = np.zeros(size, KEPT_ESTIMATE)
    return dataclasses.replace(run, replay=Replay(1.0, 1.0, Counter(), published, Tally()), details=details)


@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_whitened_fixes_of_a_consistent_estimate_have_variance_one(run: Run, factor: float) -> None:
    times, whitened = whitened_fixes(consistent_run(run, factor))["box_pose"]
    assert len(times) == 600
    np.testing.assert_allclose(whitened.std(axis=0), factor, rtol=0.1)
    np.testing.assert_allclose(whitened.mean(axis=0), 0.0, atol=0.15 * factor)


def test_nis_is_of_accepted_measurements_and_rejected_ones_are_drawn(run: Run) -> None:
    consistent = consistent_run(run)
    innovations = innovations_of(consistent)["box_pose"]
    assert innovations.mean_ratio == pytest.approx(1.0, abs=0.1)
    assert innovations.gated.sum() == 600
    (panel,) = (p for p in innovation_panels([consistent]) if p.title.startswith("box_pose: squared"))
    by_label = {curve.label: curve for curve in panel.curves}
    rejected = by_label["rejected"]
    assert rejected.form is Form.CROSSES
    np.testing.assert_allclose(rejected.values, 500.0 / 3.0)
    np.testing.assert_allclose(by_label["gate"].values, 21.1 / 3.0)
    expected, mean = by_label["expected, 95 %"], by_label["mean of 25"]
    assert expected.colour == GREEN
    assert expected.band is not None
    inside = (mean.values > expected.band[0][0]) & (mean.values < expected.band[1][0])
    assert 0.85 < inside.mean() < 1.0


# Verdicts


def test_a_good_drive_is_called_good(run: Run) -> None:
    by_name = verdicts(run, load_limits())
    for name in ("Bag", "Position", "Slip", "Rates", "Gaps", "Rejections"):
        assert by_name[name].state is State.OK, (name, by_name[name])
    for name in ("Replay = live", "Soil", "Tracks"):
        assert by_name[name].state is State.UNKNOWN, (name, by_name[name])


def with_timing(run: Run, topic: str, change: Callable[[np.ndarray], np.ndarray]) -> Run:
    times = change(run.recording.timings[topic].times)
    return changed(run, recording={"timings": {**run.recording.timings, topic: Timing(times)}})


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("Bag", lambda r: changed(r, recording={"damage": "cut short"}), "cut short"),
        ("Position", lambda r: dataclasses.replace(r, details=Details()), "no fix"),
        ("Consistency of the pose", lambda r: changed(r, nees=30.0), "3.16 times .* overconfident"),
        ("Consistency of the innovations", lambda r: consistent_run(r, 2.0), "box_pose .* overconfident"),
        ("Slip", lambda r: changed(r, slip_rmse=0.06), "at most 5 %"),
        (
            "Replay = live",
            lambda r: changed(r, live=LiveComparison(10, 3, 0.5, lost_reports=1, lost_inputs=2)),
            "unmatched: 3, lost measurements: 2, lost reports: 1",
        ),
        (
            "Rates",
            lambda r: with_timing(r, "sprockets", lambda t: np.delete(t, np.arange(5, len(t), 20))),
            "sprockets 5.0 %",
        ),
        (
            "Gaps",
            lambda r: with_timing(r, "box_pose", lambda t: t[(t < 20.0) | (t > 23.0)]),
            "Lost: box_pose",
        ),
    ],
)
def test_faults_of_a_run_need_attention(
    run: Run, name: str, change: Callable[[Run], Run], words: str
) -> None:
    verdict = verdicts(change(run), load_limits())[name]
    assert verdict.state is State.ATTENTION
    assert re.search(words, verdict.words), verdict.words


def test_sensors_better_than_stated_are_information(run: Run) -> None:
    verdict = verdicts(changed(run, nees=0.3), load_limits())["Consistency of the pose"]
    assert verdict.state is State.INFORMATION
    assert "0.32 times" in verdict.words


def test_rejections_are_shares_of_their_source(run: Run) -> None:
    rejected = Tally()
    rejected.add("box_pose", Outcome.GATED, 10)
    rejected.add("sprockets", Outcome.WAITING, 1000)
    few = changed(run, rejected=rejected)
    share = 10 / run.replay.messages["box_pose"]
    assert rejection_rows(few)[0] == ("box_pose", "gated", "10", f"{100.0 * share:.2f}")
    verdict = verdicts(few, load_limits())["Rejections"]
    assert verdict.state is State.ATTENTION
    assert "sprockets" not in verdict.value  # waiting for the first fix is not a fault


def test_sentence_that_every_measurement_was_used_is_true(run: Run) -> None:
    def words(of: Run) -> str:
        return verdicts(of, load_limits())["Rejections"].words

    def refusing(*pairs: tuple[str, Outcome]) -> Tally:
        tally = Tally()
        for source, outcome in pairs:
            tally.add(source, outcome)
        return tally

    every = "Every measurement was used."
    assert words(changed(run, rejected=Tally())) == every
    early = refusing(("sprockets", Outcome.WAITING))
    assert words(changed(run, rejected=early)) == "Since the start every measurement was used."
    soil = SoilReplay(load_soil_parameters(), rejected=refusing(("hydraulics", Outcome.INVALID)))
    assert "Share not used" in words(changed(run, rejected=Tally(), soil=soil))
    filters = InputFilters(withhold=(Withhold("box_pose", 1.0, 2.0),))
    withheld = changed(run, rejected=Tally(), withheld=[WithholdResult(filters.withhold[0], 5, None, None)])
    output = words(dataclasses.replace(withheld, filters=filters))
    assert output == "Every replayed measurement was used. 5 were withheld."


# Limits


def test_limits_of_a_file_decide(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "strict.yaml"
    file.write_text("report: {ros__parameters: {position: 0.0001}}\n", encoding="utf-8")
    limits = load_limits([str(file)])
    assert limits.slip == load_limits().slip
    assert verdicts(run, limits)["Position"].state is State.ATTENTION


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("report: {ros__parameters: {position: -1.0}}", "position: -1.0 is out of range; accepted: > 0 m"),
        ("report: {ros__parameters: {positon: 1.0}}", "did you mean 'position'"),
        ("report: {ros__parameters: {most_consistency: 0.5}}", "accepted: > 1"),
        ("position: 1.0", "accepted: a section 'report'"),
    ],
)
def test_bad_limits_are_refused_in_one_line(
    text: str, expected: str, bag: Path, tmp_path: Path, refuse: Callable[..., str]
) -> None:
    file = tmp_path / "limits.yaml"
    file.write_text(text, encoding="utf-8")
    assert expected in refuse("report", bag, "--limits", file, "--output", tmp_path / "out.html")


def test_other_parameters_need_not_match_live(run: Run) -> None:
    live = LiveComparison(10, 10, 0.5, 0, 0)
    other = changed(run, recording={"parameters": {"gate_probability": 0.5}}, live=live)
    assert verdicts(other, load_limits())["Replay = live"].state is State.UNKNOWN
