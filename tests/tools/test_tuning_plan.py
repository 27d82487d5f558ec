# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The tuner's plan with its bounds and refusals, and its search over the unit cube."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from fixtures.tuning_plans import plan_of

from trackslip_common.errors import InputError
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_tools.tuning.plan import change_parameters, read_plan
from trackslip_tools.tuning.search import search


def test_a_plan_maps_its_unit_cube_onto_the_bounds(tmp_path: Path) -> None:
    plan = plan_of(tmp_path)
    assert plan.values(np.zeros(2)) == {"sources.*.position_floor": 0.005, "gate_relaxation": 2.0}
    assert plan.values(np.ones(2)) == {"sources.*.position_floor": 2.0, "gate_relaxation": 20.0}
    middle = plan.values(np.full(2, 0.5))
    assert middle == pytest.approx({"sources.*.position_floor": 0.1, "gate_relaxation": 11.0})
    p = change_parameters(load_slip_parameters(), middle)
    assert p.poses()["box_pose"].position_floor == middle["sources.*.position_floor"]
    np.testing.assert_allclose(plan.shares(p), 0.5)
    np.testing.assert_allclose(plan.shares(change_parameters(p, {"gate_relaxation": 100.0})), (0.5, 1.0))


def test_the_example_fits_the_parameters_that_there_are() -> None:
    plan = read_plan(Path(__file__).parents[2] / "config" / "tune.yaml")
    shares = plan.shares(load_slip_parameters())
    assert ((shares > 0.0) & (shares < 1.0)).all()


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("no.such: {low: 1, high: 2}", "no.such: not to be tuned; accepted: "),
        ("odom_frame: {low: 1, high: 2}", "odom_frame: not to be tuned"),
        ("yaw_rate_stddev: {low: 1, high: 2}", "yaw_rate_stddev: not to be tuned"),
        ("gate_relaxation: 3.0", "gate_relaxation: 3.0 gives no bounds"),
        ("gate_relaxation: {low: 5.0, high: 2.0}", "low: 5 is out of range; accepted: < 2"),
        ("gate_relaxation: {low: 0.0, high: 2.0, scale: log}", "low: 0 is out of range; accepted: > 0"),
        ("gate_relaxation: {low: 0.5, high: 2.0}", "gate_relaxation: 0.5 is out of range; accepted: >= 1"),
        ("gate_relaxation: {low: 1.0, high: 2.0, scale: cubic}", "'cubic' is out of range"),
        ("gate_relaxation: {low: 1.0}", "parameter 'high' is missing"),
    ],
)
def test_a_plan_that_does_not_fit_is_refused_in_one_line(tmp_path: Path, entry: str, words: str) -> None:
    text = f"objective: likelihood\nevaluations: 40\nseed: 0\nparameters:\n  {entry}\n"
    with pytest.raises(InputError) as refused:
        plan_of(tmp_path, text.replace("{", "{{").replace("}", "}}"))
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "objective: beauty\nevaluations: 40\nseed: 0\nparameters: {{kappa: {{low: 0, high: 1}}}}",
            "'beauty'",
        ),
        ("objective: position\nevaluations: 1\nseed: 0\nparameters: {{kappa: {{low: 0, high: 1}}}}", ">= 20"),
        ("objective: position\nevaluations: 40\nseed: 0\n", "nothing to tune"),
    ],
)
def test_an_effort_that_does_not_fit_is_refused(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        plan_of(tmp_path, text)


@pytest.mark.parametrize("name", [True, 1, None])
def test_name_in_a_plan_that_is_no_text_is_refused(tmp_path: Path, name: object) -> None:
    """As ``true: log`` between the bounds."""
    file = tmp_path / "tune.yaml"
    bounds = {"low": 0.1, "high": 1.0, name: "log"}
    tree = {"objective": "likelihood", "evaluations": 20, "seed": 0, "parameters": {"turning.loss": bounds}}
    file.write_text(yaml.safe_dump(tree), encoding="utf-8")
    with pytest.raises(InputError, match=f"unknown parameter '{name}'"):
        read_plan(file)


# Search


def test_error_of_a_worker_ends_the_search() -> None:
    """scipy must not replace the error by its own."""

    def costs(_: Any) -> Any:
        raise InputError("its workers ended")

    with pytest.raises(InputError, match="its workers ended"):
        search(costs, np.array((0.1, 0.9)), 300, seed=1)


def test_the_search_finds_the_bottom_of_a_bent_valley() -> None:
    points_tried: list[np.ndarray[Any, Any]] = []

    def costs(points: Any) -> Any:
        points_tried.extend(points)
        x, y = points.T
        return (x - 0.7) ** 2 + 30.0 * (y - x**2) ** 2

    best = search(costs, np.array((0.1, 0.9)), 300, seed=1)
    np.testing.assert_allclose(best, (0.7, 0.49), atol=0.02)
    assert len(points_tried) <= 305
    assert any(np.allclose(point, (0.1, 0.9)) for point in points_tried)
    assert (np.array(points_tried) >= 0.0).all()
    assert (np.array(points_tried) <= 1.0).all()
    first = list(points_tried)
    points_tried.clear()
    search(costs, np.array((0.1, 0.9)), 300, seed=1)
    np.testing.assert_array_equal(first, points_tried)


def test_a_search_that_has_not_converged_keeps_to_its_points() -> None:
    batch_sizes: list[int] = []

    def costs(points: Any) -> Any:
        batch_sizes.append(len(points))
        return np.sum(np.sin(20.0 * points) + np.abs(points - 0.3) ** 0.2, axis=1)

    search(costs, np.full(9, 0.9), 300, seed=1)
    assert 290 <= sum(batch_sizes) <= 301
