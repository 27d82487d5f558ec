# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The tuner: its results on bags, its journal, and its files."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.tuning_plans import FLOORS, plan_of

from trackslip_common.arrays import Rows
from trackslip_common.config_files import node_parameters, read_yaml
from trackslip_common.errors import InputError
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Measurement, PoseFix
from trackslip_estimation.slip.parameters import NODE, SlipEstimatorParameters, load_slip_parameters
from trackslip_estimation.slip.records import POSE, SPROCKETS, to_records
from trackslip_tools.replay.scoring import PathErrors, path_of
from trackslip_tools.replay.series import Path as Track
from trackslip_tools.result_cache import ResultCache
from trackslip_tools.tuning.evidence import PARAMETERS, TABLE, numbers, write_evidence
from trackslip_tools.tuning.evidence import table as evidence_table
from trackslip_tools.tuning.plan import Plan, change_parameters
from trackslip_tools.tuning.task import Job, Score, Task, make_task, score_of
from trackslip_tools.tuning.tuner import Fold, ScoreJobs, Tuner, Tuning
from trackslip_tools.workers import open_workers

SEGMENTS = [
    (4.0, 2.0, 2.0, 0.05, 0.05, 0.0),
    (4.0, 1.0, 2.0, 0.0, 0.2, 0.0),
    (4.0, 2.0, 2.0, 0.05, 0.05, 0.0),
]


def measurements(drive: Callable[..., Any], seed: int = 0, sigma: float = 0.1) -> list[Measurement]:
    """Measurements with fixes whose stated covariance is far too small."""
    exact: list[Measurement] = drive(SEGMENTS, seed=seed, fix_sigma=(sigma, sigma, 0.02)).measurements
    stated_covariance = np.diag((1e-6, 1e-6, 4e-4))
    return [replace(m, covariance=stated_covariance) if isinstance(m, PoseFix) else m for m in exact]


def task_of(drive: Callable[..., Any], seed: int = 0, **changes: Any) -> Task:
    p = load_slip_parameters({"model": "free_slips"}, changes)
    truth = drive(SEGMENTS, seed=seed).truth
    stamps = np.array(sorted(truth), dtype=np.int64)
    poses = np.array([truth[stamp][:3] for stamp in stamps.tolist()])
    return make_task(f"bag{seed}", records(measurements(drive, seed), p), p, Track(stamps, poses))


def records(inputs: Sequence[Measurement], p: SlipEstimatorParameters) -> Rows:
    return to_records(inputs, SlipEstimator(p).sources)


def tuned(folder: Path, tasks: Sequence[Task], plan: Plan, work: ScoreJobs | None = None) -> Tuning:
    journal = ResultCache(folder / "journal.jsonl", Score, "--output")
    with open_workers(1, shared=tasks) as map_items:
        work = work or partial(map_items, score_of)
        return Tuner(plan, tasks, work, journal, lambda _: None).run(cross_validate=True)


# Scores


def test_fixes_are_most_likely_with_the_noise_that_they_have(drive: Callable[..., Any]) -> None:
    task = task_of(drive)
    scores = {floor: task.score({"sources.*.position_floor": floor}) for floor in (0.01, 0.03, 0.1, 0.3, 1.0)}
    likelihoods = [score.log_likelihood for score in scores.values()]
    assert likelihoods[:3] == sorted(likelihoods[:3])
    assert likelihoods[2:] == sorted(likelihoods[2:], reverse=True)
    assert scores[0.1].nis["box_pose"] == pytest.approx(1.0, abs=0.25)


def test_errors_are_those_of_the_estimator(drive: Callable[..., Any]) -> None:
    task = task_of(drive)
    values = {"sources.*.position_floor": 0.1, "noise.slip_moving": 0.02}
    estimator = SlipEstimator(change_parameters(task.p, values))
    in_order = sorted(measurements(drive), key=lambda m: m.stamp_ns)
    results = estimator.process_records(records(in_order, task.p))
    estimates = results["estimate"][results["published"]]
    result = task.score(values)
    assert task.reference is not None
    expected = PathErrors()
    expected.compare(path_of(estimates), task.reference, estimates["pose_covariance"])
    assert expected.score is not None
    assert result.position == pytest.approx(expected.score.position, rel=0.05)
    assert result.heading == pytest.approx(expected.score.heading, rel=0.05)
    assert result.nees == pytest.approx(expected.nees, rel=0.05)
    # that of the estimator spans all branches
    assert result.pose_log_likelihood == pytest.approx(expected.log_likelihood, abs=0.25)


def test_likelihood_of_a_spike_is_limited(drive: Callable[..., Any]) -> None:
    task = task_of(drive, **{"sources.box_pose.position_floor": 0.1})
    spiked = records(measurements(drive), task.p)
    fixes = np.flatnonzero(spiked["kind"] == POSE)
    spiked["value"][fixes[20]] = 1e3, -1e3, 0.0
    other = make_task("spiked", spiked, task.p, task.reference)
    rows = int((task.log.rest["kind"] != SPROCKETS).sum())
    lost = (task.score({}).log_likelihood - other.score({}).log_likelihood) * rows
    assert 0.5 < lost < 30.0


def test_without_a_reference_there_are_no_errors(drive: Callable[..., Any]) -> None:
    p = load_slip_parameters()
    task = make_task("bag", records(measurements(drive), p), p, None)
    assert np.isnan((task.score({}).position, task.score({}).heading, task.score({}).nees)).all()


# Tuning as a whole


@pytest.mark.slow
def test_tuning_corrects_a_wrong_noise_and_writes_the_evidence(
    drive: Callable[..., Any], tmp_path: Path
) -> None:
    """The noise of fixes is ten times the stated one; the value found improves each bag that is left out."""
    tasks = [task_of(drive, seed, **{"sources.box_pose.position_floor": 0.01}) for seed in range(3)]
    plan = plan_of(tmp_path)
    result = tuned(tmp_path, tasks, plan)
    assert result.values["sources.*.position_floor"] == pytest.approx(0.1, rel=0.3)
    for before, after in zip(result.before, result.after, strict=True):
        assert after.position < before.position  # the filter itself adapts to most of the noise
        assert 1.0 < after.nees < before.nees / 4.0
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
    assert "Bags that were left out are better off" in table
    assert numbers(result)["left_out"][1]["bag"] == "bag1"


@pytest.mark.slow
def test_values_that_overfit_their_bags_are_reported_as_no_better(
    drive: Callable[..., Any], tmp_path: Path
) -> None:
    """One bag has poor fixes, the other good ones: values found on either worsen the other."""
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


def test_tuning_that_changes_nothing_is_no_improvement(tmp_path: Path) -> None:
    same = [Fold(0, {}, score_at(0.1)), Fold(1, {}, score_at(0.2))]
    left_out, one_bag = tuning_of(tmp_path, [0.1, 0.2], same), tuning_of(tmp_path, [0.1], [])
    assert not left_out.improves_unseen
    assert not one_bag.improves_unseen
    assert "Bags that were left out are not better off on average." in evidence_table(left_out)
    assert "Bags are not better off on average." in evidence_table(one_bag)


def test_tuning_without_a_left_out_bag_does_not_claim_to_improve_others(tmp_path: Path) -> None:
    one_bag = replace(tuning_of(tmp_path, [0.2], []), after=[score_at(0.1)])
    assert numbers(one_bag)["improves_unseen"] is None
    assert "No bag was left out" in evidence_table(one_bag)
    write_evidence(tmp_path / "out", one_bag, load_slip_parameters())
    assert "No bag was left out" in (tmp_path / "out" / PARAMETERS).read_text()


def test_tuning_on_a_mistake_of_the_setup_names_its_bag(tmp_path: Path) -> None:
    assert (
        "mistake of the setup in bag0: correct it"
        in replace(tuning_of(tmp_path, [0.1, 0.4], [Fold(1, {}, score_at(0.2))]), mistaken=("bag0",)).verdict
    )


def test_score_of_a_left_out_bag_is_compared_with_that_of_the_same_bag(tmp_path: Path) -> None:
    assert tuning_of(tmp_path, [0.1, 0.4], [Fold(1, {}, score_at(0.2))]).improves_unseen


def test_name_of_a_bag_with_a_line_break_stays_in_the_comment_of_its_file(tmp_path: Path) -> None:
    tuning = replace(tuning_of(tmp_path, [0.1], []), bags=["one\nslip_estimator: 3"], values={})
    p = load_slip_parameters()
    write_evidence(tmp_path / "out", tuning, p)
    assert read_yaml(tmp_path / "out" / PARAMETERS) == {NODE: {"ros__parameters": {}}}


def tuning_of(folder: Path, positions: Sequence[float], folds: list[Fold]) -> Tuning:
    """A tuning that leaves the position errors (m) of the bags as they are."""
    scores = [score_at(position) for position in positions]
    names = [f"bag{k}" for k in range(len(scores))]
    return Tuning(plan_of(folder, objective="position"), names, {}, {}, scores, scores, folds)


def score_at(position: float) -> Score:
    return Score(0.0, {}, {}, position, 0.0, 3.0, 0.0)


@pytest.mark.slow
def test_position_is_an_objective_too(drive: Callable[..., Any], tmp_path: Path) -> None:
    task = task_of(drive, **{"sources.box_pose.position_floor": 0.01})
    result = tuned(tmp_path, [task], plan_of(tmp_path, objective="position"))
    assert result.after[0].position < 0.8 * result.before[0].position
    assert result.folds == []


@pytest.mark.slow
def test_interrupted_search_resumes_and_ends_with_the_same_values(
    drive: Callable[..., Any], tmp_path: Path
) -> None:
    tasks = [task_of(drive, seed) for seed in range(2)]
    plan = plan_of(tmp_path, FLOORS.replace("evaluations: 40", "evaluations: 20"))
    whole = tuned(tmp_path / "whole", tasks, plan)
    scored: list[Job] = []
    scored_until = 19

    def work(jobs: Sequence[Job]) -> Iterator[Score]:
        for bag, values in jobs:
            if len(scored) == scored_until:
                raise KeyboardInterrupt
            scored.append((bag, values))
            yield tasks[bag].score(values)

    with pytest.raises(KeyboardInterrupt):
        tuned(tmp_path / "cut", tasks, plan, work)
    journal = tmp_path / "cut" / "journal.jsonl"
    assert len(journal.read_text().splitlines()) == 19
    journal.write_text(journal.read_text()[:-7])  # killed while writing: this evaluation is repeated
    before, scored[:] = scored[:-1], []
    scored_until = 10**9
    again = tuned(tmp_path / "cut", tasks, plan, work)
    assert again.values == whole.values
    assert not [job for job in scored if job in before]
    assert len((tmp_path / "whole" / "journal.jsonl").read_text().splitlines()) == len(before) + len(scored)


@pytest.mark.slow
def test_scores_of_other_bags_are_not_used(drive: Callable[..., Any], tmp_path: Path) -> None:
    plan = plan_of(tmp_path, FLOORS.replace("evaluations: 40", "evaluations: 20"))
    tuned(tmp_path, [task_of(drive, 0)], plan)
    alone = tuned(tmp_path / "alone", [task_of(drive, 1)], plan)
    assert tuned(tmp_path, [task_of(drive, 1)], plan).values == alone.values


def test_folder_as_a_journal_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be used"):
        ResultCache(tmp_path, Score, "--output")
