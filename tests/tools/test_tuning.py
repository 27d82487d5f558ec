# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The tuner: its plan, what it makes of a bag, the search, the journal, and what it leaves behind."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from trackslip_common.config_files import node_parameters, read_yaml
from trackslip_common.errors import InputError
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Measurement, PoseFix
from trackslip_estimation.slip.parameters import NODE, SlipEstimatorParameters, load_slip_parameters
from trackslip_estimation.slip.records import POSE, SPROCKETS, to_records
from trackslip_tools.replay.arrivals import Rows
from trackslip_tools.replay.dead_reckoning import Path as Track
from trackslip_tools.replay.scoring import nees_of_each, path_of, score
from trackslip_tools.tuning.evidence import PARAMETERS, TABLE, numbers, write_evidence
from trackslip_tools.tuning.journal import Journal
from trackslip_tools.tuning.plan import Plan, changed, read_plan
from trackslip_tools.tuning.search import search
from trackslip_tools.tuning.task import Job, Score, Task, make_task, score_of
from trackslip_tools.tuning.tuner import Tuner, Tuning, Work
from trackslip_tools.workers import workers

SEGMENTS = [
    (4.0, 2.0, 2.0, 0.05, 0.05, 0.0),
    (4.0, 1.0, 2.0, 0.0, 0.2, 0.0),
    (4.0, 2.0, 2.0, 0.05, 0.05, 0.0),
]
FLOORS = """
objective: {objective}
evaluations: 40
seed: 3
parameters:
  "sources.*.position_floor": {{low: 0.005, high: 2.0, scale: log}}
  gate_relaxation: {{low: 2.0, high: 20.0}}
"""


def plan_of(folder: Path, text: str = FLOORS, objective: str = "likelihood") -> Plan:
    file = folder / "tune.yaml"
    file.write_text(text.format(objective=objective))
    return read_plan(file)


def measurements(drive: Callable[..., Any], seed: int = 0, sigma: float = 0.1) -> list[Measurement]:
    """Fixes that claim to be far better than they are."""
    found: list[Measurement] = drive(SEGMENTS, seed=seed, fix_sigma=(sigma, sigma, 0.02)).measurements
    claimed = np.diag((1e-6, 1e-6, 4e-4))
    return [replace(m, covariance=claimed) if isinstance(m, PoseFix) else m for m in found]


def task_of(drive: Callable[..., Any], seed: int = 0, **changes: Any) -> Task:
    p = load_slip_parameters({"model": "free_slips"}, changes)
    truth = drive(SEGMENTS, seed=seed).truth
    stamps = np.array(sorted(truth), dtype=np.int64)
    poses = np.array([truth[stamp][:3] for stamp in stamps.tolist()])
    return make_task(f"bag{seed}", records(measurements(drive, seed), p), p, Track(stamps, poses))


def records(found: Sequence[Measurement], p: SlipEstimatorParameters) -> Rows:
    return to_records(found, SlipEstimator(p).sources)


def tuned(folder: Path, tasks: Sequence[Task], plan: Plan, work: Work | None = None) -> Tuning:
    with Journal(folder / "journal.jsonl", tasks, plan.bounds) as journal, workers(1, shared=tasks) as mapped:
        work = work or partial(mapped, score_of)
        return Tuner(plan, tasks, work, journal, lambda _: None).run(cross_validate=True)


# the plan


def test_a_plan_maps_its_unit_cube_onto_the_bounds(tmp_path: Path) -> None:
    plan = plan_of(tmp_path)
    assert plan.values(np.zeros(2)) == {"sources.*.position_floor": 0.005, "gate_relaxation": 2.0}
    assert plan.values(np.ones(2)) == {"sources.*.position_floor": 2.0, "gate_relaxation": 20.0}
    middle = plan.values(np.full(2, 0.5))
    assert middle == pytest.approx({"sources.*.position_floor": 0.1, "gate_relaxation": 11.0})
    p = changed(load_slip_parameters(), middle)
    assert p.poses()["box_pose"].position_floor == middle["sources.*.position_floor"]
    np.testing.assert_allclose(plan.shares(p), 0.5)
    np.testing.assert_allclose(plan.shares(changed(p, {"gate_relaxation": 100.0})), (0.5, 1.0))


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


# scores


def test_fixes_are_most_likely_with_the_noise_that_they_have(drive: Callable[..., Any]) -> None:
    task = task_of(drive)
    scores = {floor: task.score({"sources.*.position_floor": floor}) for floor in (0.01, 0.03, 0.1, 0.3, 1.0)}
    assert max(scores, key=lambda floor: scores[floor].log_likelihood) == 0.1
    assert scores[0.1].nis["box_pose"] == pytest.approx(1.0, abs=0.25)
    assert scores[0.01].rejected["box_pose"] > 10 > scores[0.1].rejected["box_pose"]


def test_errors_are_those_of_the_estimator(drive: Callable[..., Any]) -> None:
    task = task_of(drive)
    values = {"sources.*.position_floor": 0.1, "noise.slip_moving": 0.02}
    estimator = SlipEstimator(changed(task.p, values))
    given = sorted(measurements(drive), key=lambda m: m.stamp_ns)
    results = estimator.process_records(records(given, task.p))
    estimates = results["estimate"][results["published"]]
    found = task.score(values)
    assert task.reference is not None
    expected = score(path_of(estimates), task.reference)
    assert expected is not None
    assert found.position == pytest.approx(expected.position, rel=0.05)
    assert found.heading == pytest.approx(expected.heading, rel=0.05)
    nees = nees_of_each(path_of(estimates), estimates["pose_covariance"], task.reference)[0]
    assert found.nees == pytest.approx(np.mean(nees), rel=0.05)


def test_a_spike_costs_no_more_than_a_wrong_measurement_may(drive: Callable[..., Any]) -> None:
    task = task_of(drive, **{"sources.box_pose.position_floor": 0.1})
    spiked = records(measurements(drive), task.p)
    fixes = np.flatnonzero(spiked["kind"] == POSE)
    spiked["value"][fixes[20]] = 1e3, -1e3, 0.0
    other = make_task("spiked", spiked, task.p, task.reference)
    rows = int((task.log.rest["kind"] != SPROCKETS).sum())
    lost = (task.score({}).log_likelihood - other.score({}).log_likelihood) * rows
    assert 5.0 < lost < 30.0


def test_without_a_reference_there_are_no_errors(drive: Callable[..., Any]) -> None:
    p = load_slip_parameters()
    task = make_task("bag", records(measurements(drive), p), p, None)
    assert np.isnan((task.score({}).position, task.score({}).heading, task.score({}).nees)).all()


# the search


def test_what_ends_the_workers_ends_the_search() -> None:
    """scipy took it for a mistake in the way it is called, and a traceback came of it."""

    def costs(_: Any) -> Any:
        raise InputError("its workers ended")

    with pytest.raises(InputError, match="its workers ended"):
        search(costs, np.array((0.1, 0.9)), 300, seed=1)


def test_the_search_finds_the_bottom_of_a_bent_valley() -> None:
    asked: list[np.ndarray[Any, Any]] = []

    def costs(points: Any) -> Any:
        asked.extend(points)
        x, y = points.T
        return (x - 0.7) ** 2 + 30.0 * (y - x**2) ** 2

    best = search(costs, np.array((0.1, 0.9)), 300, seed=1)
    np.testing.assert_allclose(best, (0.7, 0.49), atol=0.02)
    assert len(asked) <= 305
    assert any(np.allclose(point, (0.1, 0.9)) for point in asked)
    assert (np.array(asked) >= 0.0).all()
    assert (np.array(asked) <= 1.0).all()
    first = list(asked)
    asked.clear()
    search(costs, np.array((0.1, 0.9)), 300, seed=1)
    np.testing.assert_array_equal(first, asked)


def test_a_search_that_has_not_converged_keeps_to_its_points() -> None:
    asked: list[int] = []

    def costs(points: Any) -> Any:
        asked.append(len(points))
        return np.sum(np.sin(20.0 * points) + np.abs(points - 0.3) ** 0.2, axis=1)

    search(costs, np.full(9, 0.9), 300, seed=1)
    assert 290 <= sum(asked) <= 301


# the whole


def test_tuning_mends_what_was_wrong_and_shows_it(drive: Callable[..., Any], tmp_path: Path) -> None:
    """Fixes ten times as bad as they say: found on three bags, and good for each that had no say."""
    tasks = [task_of(drive, seed, **{"sources.box_pose.position_floor": 0.01}) for seed in range(3)]
    plan = plan_of(tmp_path)
    result = tuned(tmp_path, tasks, plan)
    assert result.values["sources.*.position_floor"] == pytest.approx(0.1, rel=0.3)
    for before, after in zip(result.before, result.after, strict=True):
        assert after.position < before.position  # most of it the filter had found by itself
        assert 1.0 < after.nees < before.nees / 5.0
    assert [fold.bag for fold in result.folds] == [0, 1, 2]
    for fold in result.folds:
        assert fold.score.position < result.before[fold.bag].position
    assert result.improves_unseen

    write_evidence(tmp_path / "out", result, tasks[0].p)
    layer = node_parameters(read_yaml(tmp_path / "out" / PARAMETERS), NODE, "tuned")
    assert (
        load_slip_parameters(layer).poses()["box_pose"].position_floor
        == result.values["sources.*.position_floor"]
    )
    table = (tmp_path / "out" / TABLE).read_text()
    assert table.count("| bag1") == 3
    assert "Bags that had no say are better off" in table
    assert numbers(result)["left_out"][1]["bag"] == "bag1"


def test_values_that_only_fit_their_own_bags_are_not_better_for_others(
    drive: Callable[..., Any], tmp_path: Path
) -> None:
    """One bag's fixes are bad, the other's good: what is found on either harms the other."""
    p = load_slip_parameters({"model": "free_slips", "sources.box_pose.position_floor": 0.1})
    tasks = [
        make_task(f"bag{k}", records(measurements(drive, k, sigma), p), p, None)
        for k, sigma in enumerate((0.01, 1.0))
    ]
    result = tuned(tmp_path, tasks, plan_of(tmp_path))
    assert not result.improves_unseen
    for fold in result.folds:
        assert fold.score.log_likelihood < result.before[fold.bag].log_likelihood
    assert sum(s.log_likelihood for s in result.after) > sum(s.log_likelihood for s in result.before)
    write_evidence(tmp_path / "out", result, p)
    assert "are not better off" in (tmp_path / "out" / TABLE).read_text()
    assert not numbers(result)["improves_unseen"]


def test_position_is_an_objective_too(drive: Callable[..., Any], tmp_path: Path) -> None:
    task = task_of(drive, **{"sources.box_pose.position_floor": 0.01})
    result = tuned(tmp_path, [task], plan_of(tmp_path, objective="position"))
    assert result.after[0].position < 0.8 * result.before[0].position
    assert result.folds == []


def test_an_interrupted_search_goes_on_and_ends_the_same(drive: Callable[..., Any], tmp_path: Path) -> None:
    tasks = [task_of(drive, seed) for seed in range(2)]
    plan = plan_of(tmp_path)
    whole = tuned(tmp_path / "whole", tasks, plan)
    scored: list[Job] = []
    scored_until = 31

    def work(jobs: Sequence[Job]) -> Iterator[Score]:
        for bag, values in jobs:
            if len(scored) == scored_until:
                raise KeyboardInterrupt
            scored.append((bag, values))
            yield tasks[bag].score(values)

    with pytest.raises(KeyboardInterrupt):
        tuned(tmp_path / "cut", tasks, plan, work)
    journal = tmp_path / "cut" / "journal.jsonl"
    assert len(journal.read_text().splitlines()) == 32
    journal.write_text(journal.read_text()[:-7])  # killed while it wrote: that one is scored again
    before, scored[:] = scored[:-1], []
    scored_until = 10**9
    again = tuned(tmp_path / "cut", tasks, plan, work)
    assert again.values == whole.values
    assert not [job for job in scored if job in before]
    assert len((tmp_path / "whole" / "journal.jsonl").read_text().splitlines()) == 1 + len(before) + len(
        scored
    )


@pytest.mark.parametrize(
    "line",
    [
        *('{"bag": "0", "values": [0.5], "score": 1}', '{"bag": 0, "values": [[0.5]], "score": 1}', "{}"),
        '{"bag": 0, "values": [0.5], "score": {"log_likelihood": "high"}}',
    ],
)
def test_a_journal_with_values_of_other_types_is_refused(
    drive: Callable[..., Any], tmp_path: Path, line: str
) -> None:
    """They ended the search later, with a traceback."""
    plan, file = plan_of(tmp_path), tmp_path / "journal.jsonl"
    with Journal(file, [task_of(drive, 0)], plan.bounds):
        pass
    file.write_text(f"{file.read_text(encoding='utf-8')}\n{line}", encoding="utf-8")
    with pytest.raises(InputError, match="is no journal of tune"):
        Journal(file, [task_of(drive, 0)], plan.bounds)


@pytest.mark.parametrize("name", [True, 1, None])
def test_a_name_in_a_plan_that_is_no_text_is_refused(tmp_path: Path, name: object) -> None:
    """``true: log`` between the bounds ended tune with a traceback."""
    file = tmp_path / "tune.yaml"
    bounds = {"low": 0.1, "high": 1.0, name: "log"}
    tree = {"objective": "likelihood", "evaluations": 20, "seed": 0, "parameters": {"turning.loss": bounds}}
    file.write_text(yaml.safe_dump(tree), encoding="utf-8")
    with pytest.raises(InputError, match=f"unknown parameter '{name}'"):
        read_plan(file)


def test_a_journal_of_other_bags_is_refused(drive: Callable[..., Any], tmp_path: Path) -> None:
    plan, file = plan_of(tmp_path), tmp_path / "journal.jsonl"
    with Journal(file, [task_of(drive, 0)], plan.bounds):
        pass
    for tasks, names in (([task_of(drive, 1)], plan.bounds), ([task_of(drive, 0)], {"kappa": 0})):
        with pytest.raises(InputError, match="is of other bags or parameters"):
            Journal(file, tasks, names)
    file.write_text("{}")
    with pytest.raises(InputError, match="other bags"):
        Journal(file, [task_of(drive, 0)], plan.bounds)
    with pytest.raises(InputError, match="cannot be used"):
        Journal(tmp_path, [task_of(drive, 0)], plan.bounds)
