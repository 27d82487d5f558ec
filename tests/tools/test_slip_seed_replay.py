# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Slip seeds in a bag: replayed bit for bit if their source is listed, otherwise without effect."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.arrival_rows import measurements_of
from fixtures.made_bags import write_messages
from fixtures.recorded import merged_messages, write_lines
from fixtures.whole_inputs import read_inputs

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.messages import make, serialize
from trackslip_bags.reader import open_bag
from trackslip_common.topics import TOPICS
from trackslip_estimation.slip.conversions import measurement_report
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Outcome, Report, SlipFix
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.soil.conversions import message_of
from trackslip_estimation.soil.records import SlipSeed
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_tools.replay.output import EstimateWriter
from trackslip_tools.replay.parts import Part
from trackslip_tools.replay.result import Replay
from trackslip_tools.replay.run import replay
from trackslip_tools.replay.soil import SoilReplay
from trackslip_tools.replay.soil_output import soil_messages
from trackslip_tools.tuning.task import read_task

SOURCE = {"slip_sources": ["slip_seed"]}
_LATE_NS = 500_000_000
REPORTS = TOPICS["measurement_reports"].type_name
LAST_NS = 1_700_000_100_000_000_000  # later than all messages


@pytest.fixture(scope="module")
def seeded(lines: list[Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drive with a seed in each straight leg, the second one invalid; each arrives 0.5 s late."""
    origin_ns = min(line.log_ns for line in lines)
    seeds = []
    for t, slip in ((3.0, 0.02), (9.0, float("nan"))):
        seed = SlipSeed(origin_ns + round(t * 1e9), np.full(2, slip), 1e-6 * (np.ones((2, 2)) + np.eye(2)))
        message = message_of(make, seed, "base_link")
        seeds.append(lines[0].instead("slip_seed", message)._replace(log_ns=seed.stamp_ns + _LATE_NS))
    return write_lines(tmp_path_factory.mktemp("seeds") / "bag", [*lines, *seeds])


def replayed(path: Path, parts: list[Part] | None = None, **changes: Any) -> Replay:
    watch = ([] if parts is None else parts).append
    with open_bag(path) as bag:
        return replay(bag, load_slip_parameters(changes), InputFilters(), None, watch=watch)


def reports_of(parts: list[Part]) -> list[Report]:
    reports = []
    for part in parts:
        names = [part.sources[source] for source in part.arrivals["source"]]
        rows = part.results[["stamp_ns", "outcome", "nis", "gate", "dof"]].tolist()
        reports += [
            Report(name, row[0], Outcome(row[1]), *row[2:]) for name, row in zip(names, rows, strict=True)
        ]
    return reports


def numbers(result: Replay) -> list[bytes]:
    return [estimate.tobytes() for estimate in result.estimates]


def test_replay_processes_seeds_as_the_estimator_does(seeded: Path) -> None:
    parts: list[Part] = []
    result = replayed(seeded, parts, **SOURCE)
    reports = [report for report in reports_of(parts) if report.source == "slip_seed"]
    assert [report.outcome for report in reports] == [Outcome.ACCEPTED, Outcome.INVALID]
    assert result.messages["slip_seed"] == 2
    assert "invalid" not in result.rejected.by_source()["slip_seed"]
    assert sum(result.rejected.by_source()["slip_seed"].values()) == 1
    p = load_slip_parameters(SOURCE)
    with open_bag(seeded) as bag:
        inputs = measurements_of(read_inputs(bag, p, InputFilters(), ()))
    assert sum(isinstance(m, SlipFix) for m in inputs) == 2
    estimator = SlipEstimator(p)
    estimates = [estimate for _, estimate in map(estimator.process, inputs) if estimate is not None]
    assert [slips.tobytes() for slips in result.estimates["slips"]] == [
        e.outputs.slips.tobytes() for e in estimates
    ]


def test_live_run_with_seeds_is_replayed_exactly(seeded: Path, tmp_path: Path) -> None:
    p = load_slip_parameters(SOURCE)
    parts: list[Part] = []
    with open_bag(seeded) as bag, EstimateWriter(tmp_path / "own", p) as writer:
        replay(bag, p, InputFilters(), None, watch=writer.add)
    replayed(seeded, parts, **SOURCE)
    journal = (measurement_report(make, report, k) for k, report in enumerate(reports_of(parts)))
    lines = [("/measurement_reports", REPORTS, LAST_NS + m.sequence, serialize(m)) for m in journal]
    write_messages(tmp_path / "live", [*merged_messages(seeded, tmp_path / "own"), *lines])
    again = replayed(tmp_path / "live", **SOURCE)
    assert again.live is not None
    assert again.live.matches
    assert again.live.largest_difference == 0.0
    assert again.live.lost_inputs == 0
    ignoring = replayed(tmp_path / "live")
    assert ignoring.live is not None
    assert not ignoring.live.matches


def test_unrequested_seeds_change_nothing(seeded: Path, bag: Path) -> None:
    ignoring, without_seeds = replayed(seeded), replayed(bag)
    assert numbers(ignoring) == numbers(without_seeds)
    assert numbers(replayed(seeded, **SOURCE)) != numbers(without_seeds)


def test_tuning_with_seeds_has_finite_scores(seeded: Path) -> None:
    with open_bag(seeded) as bag:
        task = read_task(bag, load_slip_parameters(SOURCE), InputFilters(), None, needs_reference=True)
    scores = task.score({})
    assert "slip_seed" in scores.nis
    assert np.isfinite((scores.log_likelihood, scores.position)).all()


def test_a_replay_writes_the_seeds_of_its_soil_estimator() -> None:
    seed = SlipSeed(5, np.array((0.01, 0.02)), np.eye(2))
    written = {
        topic: message
        for topic, message, _ in soil_messages(SoilReplay(load_soil_parameters(), seeds=[seed]))
    }
    assert (written["slip_seed"].left_slip, written["slip_seed"].right_slip) == (0.01, 0.02)
