# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip report`` of a drive with known truth: its plots, tables and page."""

import dataclasses
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.made_bags import write_bag, write_messages

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.messages import header, make
from trackslip_bags.reader import open_bag
from trackslip_common.errors import ExitCode
from trackslip_common.topics import FORCES, SOIL, TOPICS, TRUE_SOIL
from trackslip_tools.cli.main import main
from trackslip_tools.report.headline import facts_of
from trackslip_tools.report.page import render
from trackslip_tools.report.panel import INK, MOST_RUNS, Form, Panel
from trackslip_tools.report.panels import error_panels, errors_of, ground_panels, motion_panels
from trackslip_tools.report.path_plot import boxes, ellipses, path_plot
from trackslip_tools.report.recording import Timing, read_recording
from trackslip_tools.report.run import Run
from trackslip_tools.report.tables import differing_rows, parameter_rows, topic_rows
from trackslip_tools.report.timeline import events_of
from trackslip_tools.report.verdict import load_limits

MS = 1_000_000
MOST_BYTES = 6_000_000


@pytest.fixture
def run(emulated_run: Run) -> Run:
    return emulated_run


def titled(panels: list[Panel], start: str) -> Panel:
    (found,) = (panel for panel in panels if panel.title.startswith(start))
    return found


# Plots


def test_the_errors_shown_are_those_that_are_scored(run: Run) -> None:
    assert run.states is not None
    errors = errors_of(run, run.states)
    assert errors is not None
    scored = run.replay.scores["filter"]
    assert scored is not None
    distance = np.hypot(errors.values[:, 0], errors.values[:, 1])
    assert np.sqrt(np.mean(distance**2)) == pytest.approx(scored.position, rel=1e-9)
    assert np.sqrt(np.mean(errors.values[:, 2] ** 2)) == pytest.approx(scored.heading, rel=1e-9)
    position, heading = error_panels([run])
    np.testing.assert_allclose(position.curves[0].values, 100.0 * distance)  # cm
    np.testing.assert_allclose(heading.curves[0].values, np.degrees(errors.values[:, 2]))


def test_slips_are_drawn_beside_the_truth_while_moving(run: Run) -> None:
    panel = titled(motion_panels([run]), "Slip of the right")
    truth, estimate = panel.curves
    assert (truth.label, truth.colour, truth.band) == ("truth", INK, None)
    early = estimate.times < 2.5  # at standstill
    assert early.any()
    assert np.isnan(estimate.values[early]).all()
    assert np.isnan(truth.values[truth.times < 2.5]).all()
    true_slips = np.interp(estimate.times, truth.times, truth.values)
    later = estimate.times > 12.0
    assert run.states is not None
    assert run.states.is_moving[later].all()
    assert np.sqrt(np.nanmean((estimate.values - true_slips)[later] ** 2)) < 10.0  # %
    assert estimate.band is not None
    low, high = estimate.band
    np.testing.assert_allclose((low + high)[later], 2.0 * estimate.values[later])
    sigmas = np.sqrt(run.states.rows["slip_covariance"][later, 1, 1])
    np.testing.assert_allclose((high - low)[later], 100.0 * 4.0 * sigmas)


def test_the_smoother_is_shown_beside_the_filter(run: Run) -> None:
    smoothed_rows = run.details.estimates[1000:]
    with_smoother = dataclasses.replace(run, smoothed=smoothed_rows)
    panel = titled(motion_panels([with_smoother]), "Speed")
    _, estimate, smoothed = panel.curves
    assert (estimate.label, smoothed.label, smoothed.form) == ("estimate", "smoothed", Form.DASHED)
    np.testing.assert_array_equal(smoothed.values, estimate.values[1000:])
    assert [curve.label for curve in error_panels([with_smoother])[0].curves] == ["estimate", "smoothed"]
    labels = [item.label.value for item in path_plot([with_smoother], 100).plot.legend[0].items]
    assert "smoothed" in labels


def test_ellipses_are_at_two_standard_deviations(run: Run) -> None:
    assert run.states is not None
    outlines = ellipses(run.states)
    last = outlines[-1] - run.states.path.poses[-1, :2]
    covariance = run.states.rows["pose_covariance"][-1, :2, :2]
    distances = np.sqrt(np.einsum("ki,ij,kj->k", last, np.linalg.inv(covariance), last))
    np.testing.assert_allclose(distances, 2.0)


def test_box_is_drawn_at_its_pose(run: Run) -> None:
    first = boxes(run)[0]
    np.testing.assert_allclose(first[:-1].mean(axis=0), (0.0, 0.0), atol=0.05)
    sides = np.linalg.norm(np.diff(first, axis=0), axis=1)
    box = run.parameters.vehicle.box
    np.testing.assert_allclose(sides, (box.length, box.width, box.length, box.width))


def test_laser_points_are_on_the_walls_of_the_site(run: Run) -> None:
    """The fence of config/site.yaml from (−12, 14) to (22, 16)."""
    points = run.recording.points
    fence = points[(points[:, 1] > 13.0) & (points[:, 1] < 17.0)]
    assert len(fence) > 50
    along = 14.0 + (fence[:, 0] + 12.0) * 2.0 / 34.0
    assert np.median(np.abs(fence[:, 1] - along)) < 0.05


# Soil


FORCES_FIELDS = {"left_thrust": 2000.0, "left_thrust_variance": 100.0**2, "left_resistance": 900.0}
SOIL_FIELDS = {
    "shear_modulus": 0.02,
    "shear_modulus_lower": 0.01,
    "shear_modulus_upper": 0.05,
    "reason": "the slips are small",
    "class_names": ["sand", "dry_clay"],
    "class_probabilities": [0.3, 0.7],
}


def soil_messages(count: int) -> Iterator[tuple[str, Any]]:
    """Topics and messages of forces, soil, and the same soil as the truth, at 10 Hz."""
    for stamp in (header(k * 100 * MS, "") for k in range(count)):
        yield FORCES, make(TOPICS[FORCES].type_name, header=stamp, **FORCES_FIELDS)
        for topic in (SOIL, TRUE_SOIL):
            yield topic, make(TOPICS[topic].type_name, header=stamp, **SOIL_FIELDS)


def test_forces_and_soil_of_a_bag_are_shown_with_their_intervals(run: Run, tmp_path: Path) -> None:
    assert [panel.title for panel in ground_panels([run])] == []
    with open_bag(write_bag(tmp_path / "bag", soil_messages(10))) as bag:
        numbers = read_recording(bag, InputFilters()).numbers
    recording = dataclasses.replace(run.recording, numbers=numbers)
    panels = ground_panels([dataclasses.replace(run, recording=recording)])
    thrust, resistance = titled(panels, "Forces on the left").curves
    np.testing.assert_allclose(thrust.times, 0.1 * np.arange(10))
    np.testing.assert_allclose(thrust.values, 2.0)  # kN
    assert thrust.band is not None
    np.testing.assert_allclose(thrust.band[1], 2.2)
    np.testing.assert_allclose(resistance.values, 0.9)
    truth, shear = titled(panels, "Shear").curves
    assert (truth.label, truth.colour) == ("true K", INK)
    assert shear.band is not None
    np.testing.assert_allclose((shear.band[0][0], shear.values[0], shear.band[1][0]), (1.0, 2.0, 5.0))  # cm
    likely = titled(panels, "Class of soil").curves
    assert [(curve.label, curve.values[-1]) for curve in likely] == [("dry_clay", 70.0), ("sand", 30.0)]  # %


def test_times_count_from_the_begin_of_a_bag_whose_stamps_are_of_simulated_time(
    emulated_bag: Path, run_over: Callable[..., Run], tmp_path: Path
) -> None:
    """Simulated time begins at 0; the recorder logs by the computer's clock."""
    with open_bag(emulated_bag) as bag:
        logged = [message._replace(log_time_ns=message.log_time_ns + 10**18) for message in bag.messages()]
    run, changed = run_over(emulated_bag), run_over(write_messages(tmp_path / "bag", logged))
    assert changed.states is not None
    assert run.states is not None
    seconds = changed.recording.seconds(changed.states.path.stamps_ns)
    np.testing.assert_allclose(seconds, run.recording.seconds(run.states.path.stamps_ns), atol=0.1)
    assert changed.replay.longest_gap == pytest.approx(run.replay.longest_gap, abs=0.1)


@pytest.mark.parametrize("is_identifiable", [True, False])
def test_only_an_identifiable_soil_is_named_as_found(run: Run, tmp_path: Path, is_identifiable: bool) -> None:
    stamped = make(TOPICS[SOIL].type_name, header=header(0, ""), identifiable=is_identifiable, **SOIL_FIELDS)
    with open_bag(write_bag(tmp_path / "bag", [(SOIL, stamped)])) as bag:
        numbers = read_recording(bag, InputFilters()).numbers
    of_soil = dataclasses.replace(run, recording=dataclasses.replace(run.recording, numbers=numbers))
    (fact,) = (fact for fact in facts_of(of_soil, load_limits(), {}, []) if fact.name == "Soil")
    assert fact.value == ("dry clay, 70 %" if is_identifiable else "undetermined")
    reported = [event.text for event in events_of(of_soil) if "soil" in event.text]
    assert reported == (["soil found: dry_clay, 70 %"] if is_identifiable else [])


# Tables and page


def test_a_comparison_shows_the_parameters_that_differ(
    emulated_bag: Path, run: Run, run_over: Callable[..., Run]
) -> None:
    other = run_over(emulated_bag, "other", gate_probability=0.9)
    rows = parameter_rows([run, other])
    assert len(rows) > 50
    assert [row[0] for row in differing_rows(rows)] == ["slip_estimator.gate_probability"]
    assert differing_rows(rows)[0][2:] == ("0.9999", "0.9999", "0.9")
    labels = {curve.label for panel in motion_panels([run, other]) for curve in panel.curves}
    assert labels == {"truth", "a run", "other"}


def test_topics_are_counted(run: Run) -> None:
    rows = {row[0]: row[1:] for row in topic_rows(run)}
    assert rows["sprockets"][1:3] == ("100.00", "100.00")
    assert int(rows["sprockets"][0]) == len(run.recording.timings["sprockets"].times)


@pytest.mark.slow
def test_the_page_needs_nothing_else_and_is_small_enough(run: Run) -> None:
    page = render([run], load_limits())
    assert len(page.encode()) < MOST_BYTES
    body = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    assert not re.search(r"""(?:src|href|url)\s*[=(]\s*["']?\s*(?:https?:)?//""", body)
    assert "<link" not in body
    assert not re.search(r"<script[^>]+src", page)


def test_names_that_look_like_html_are_text(run: Run) -> None:
    evil = "<img src=x onerror=alert(1)>"
    recording = dataclasses.replace(run.recording, path=evil, timings={evil: Timing(np.arange(9.0))})
    page = render([dataclasses.replace(run, label=evil, recording=recording)] * 2, load_limits())
    assert evil not in page
    assert "&lt;img src=x" in page


def report(*arguments: object) -> int:
    return main(["report", *map(str, arguments)])


@pytest.mark.slow
def test_one_bag_with_two_parameter_files_is_a_comparison(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tuned = tmp_path / "tuned.yaml"
    tuned.write_text("slip_estimator: {ros__parameters: {gate_probability: 0.9}}\n", encoding="utf-8")
    output = tmp_path / "report.html"
    assert report(bag, "--params", "own", "--params", tuned, "--output", output) == ExitCode.DONE
    assert f"report: {output}" in capsys.readouterr().out
    page = output.read_text(encoding="utf-8")
    assert "2 runs compared" in page
    assert str(tuned) in page


def test_a_bag_without_an_estimate_makes_a_page_and_exit_code_1(bag: Path, tmp_path: Path) -> None:
    output = tmp_path / "report.html"
    assert report(bag, "--withhold", "box_pose", "--output", output) == ExitCode.FAILED
    page = output.read_text(encoding="utf-8")
    assert "No fix came: box_pose is withheld" in page
    assert "No measurement was used" in page
    assert "very measurement was used" not in page


def test_a_report_without_poses_has_no_warning(
    bag: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with open_bag(bag) as opened:
        messages = list(opened.messages(["sprockets"]))[:50]
    sprockets = write_messages(tmp_path / "bag", messages)
    assert report(sprockets, "--output", tmp_path / "report.html") == ExitCode.FAILED
    assert not caplog.records


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["BAG"], "--output"),
        (["BAG", *["--params", "own"] * (MOST_RUNS + 1), "--output", "OUT"], "at most 6"),
        (["nowhere", "--output", "OUT"], "bag 'nowhere' not found"),
        (["BAG", "--params", "nowhere.yaml", "--output", "OUT"], "file 'nowhere.yaml' not found"),
        (["BAG", "--output", "nowhere/report.html"], "--output: 'nowhere/report.html' cannot be written"),
    ],
)
def test_bad_arguments(
    arguments: list[str], expected: str, bag: Path, tmp_path: Path, refuse: Callable[..., str]
) -> None:
    places = {"BAG": str(bag), "OUT": str(tmp_path / "report.html")}
    assert expected in refuse("report", *(places.get(argument, argument) for argument in arguments))
