# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The part of a recording that is compared with live estimates if measurements or runs are missing."""

import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import pytest
from fixtures.commands import json_of
from fixtures.recorded import EPOCH_NS, MS, Line, in_order_of_journal, write_lines

from trackslip_bags.messages import make
from trackslip_bags.parameters import PARAMETERS_TOPIC, PARAMETERS_TYPE
from trackslip_common.config_files import parameters_text
from trackslip_common.parameters import to_flat
from trackslip_common.topics import LOCAL_ODOMETRY, ODOMETRY, TRACK_SLIP
from trackslip_estimation.slip import conversions
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.learned import Learned, to_tree
from trackslip_estimation.slip.local_odometry import LocalOdometry
from trackslip_estimation.slip.parameters import NODE, SlipEstimatorParameters, load_slip_parameters
from trackslip_tools.replay.output import message_of

Compare = Callable[..., tuple[bool | None, dict[str, Any]]]
REPORTS = "measurement_reports"
RESTART_S, BEFORE_NS = 5.0, 400 * MS


def at_ns(seconds: float) -> int:
    return EPOCH_NS + round(seconds * 1e9)


def live(
    lines: list[Line], p: SlipEstimatorParameters, learned: Learned | None = None
) -> tuple[list[Line], SlipEstimator]:
    """The messages of an estimator that receives the lines without delay."""
    estimator, local, messages = SlipEstimator(p, learned=learned), LocalOdometry(), []
    in_order = sorted(lines, key=lambda line: line.log_ns)
    learned_section = {} if learned is None else {"learned": to_tree(learned, estimator.learned_context)}
    text = make(PARAMETERS_TYPE, data=parameters_text(to_flat(p), NODE, **learned_section))
    messages.append(Line(in_order[0].log_ns - BEFORE_NS, PARAMETERS_TOPIC, text))
    for sequence, line in enumerate(in_order):
        report, estimate = estimator.process(measurement(line, p))
        outputs = [] if estimate is None else [(t, estimate) for t in (ODOMETRY, TRACK_SLIP)]
        outputs += [] if estimate is None else [(LOCAL_ODOMETRY, local.estimate_in_odom(estimate))]
        of_line = [(topic, message_of(topic, of, p)) for topic, of in outputs]
        of_line.append((REPORTS, conversions.measurement_report(make, report, sequence)))
        messages += [Line(line.log_ns + 1, topic, message) for topic, message in of_line]
    return messages, estimator


def measurement(line: Line, p: SlipEstimatorParameters) -> Any:
    if line.topic == "sprockets":
        return conversions.sprockets(line.message, line.topic)
    if line.topic == "box_pose":
        return conversions.pose_fix(line.message, line.topic)
    return conversions.yaw_rate(line.message, line.topic, p.gyros()[line.topic])


@pytest.fixture(scope="module")
def inputs(lines: list[Line]) -> list[Line]:
    return [line for line in lines if line.topic != "reference_pose"]


@pytest.fixture(scope="module")
def one_run(inputs: list[Line]) -> list[Line]:
    """All messages that a recorder writes of a run."""
    return [*inputs, *live(inputs, load_slip_parameters())[0]]


@pytest.fixture(scope="module")
def two_runs(inputs: list[Line]) -> list[Line]:
    """The estimator is killed after 5 s and restarts from its learned states."""
    return restarted(inputs)


def restarted(inputs: list[Line], **changes: Any) -> list[Line]:
    first, estimator = live(until(inputs, RESTART_S), load_slip_parameters())
    later = since(inputs, RESTART_S + 0.5)  # no estimator runs in between
    second, _ = live(later, load_slip_parameters(changes), estimator.learned)
    return [*inputs, *first, *second]


def until(lines: list[Line], seconds: float) -> list[Line]:
    return [line for line in lines if line.log_ns < at_ns(seconds)]


def since(lines: list[Line], seconds: float) -> list[Line]:
    return [line for line in lines if line.log_ns >= at_ns(seconds)]


def without(lines: list[Line], topic: str, begin: float, end: float) -> list[Line]:
    return [x for x in lines if not (x.topic == topic and at_ns(begin) <= x.log_ns < at_ns(end))]


@pytest.fixture
def compare(bag_of: Callable[[Iterable[Line]], Path], summary: Callable[..., dict[str, Any]]) -> Compare:
    """A function that replays a bag of lines; returns whether estimates match, and the compared parts."""

    def replayed(run: Iterable[Line], *options: str) -> tuple[bool | None, dict[str, Any]]:
        result = summary(bag_of(run), *options)
        return result["replay_matches"], result["replay_compared"]

    return replayed


@pytest.mark.parametrize("recorders", [1, 2])
def test_a_whole_run_is_compared_whole(
    one_run: list[Line], compare: Compare, printed: Callable[[], str], recorders: int
) -> None:
    copies = [line._replace(log_ns=line.log_ns + 3 * MS * k) for k in range(recorders) for line in one_run]
    matches, compared = compare(copies)
    assert matches is True
    assert compared["breaks"] == []
    (part,) = compared["parts"]
    assert part["start"] < 1.0
    assert part["stop"] > 10.0
    assert not re.search("not from|lacks", printed())


def test_lines_of_two_estimators_at_once_are_not_counted_as_missing(
    inputs: list[Line], one_run: list[Line], compare: Compare, printed: Callable[[], str]
) -> None:
    other = live(since(inputs, 2.0), load_slip_parameters())[0]
    _, compared = compare([*one_run, *other])
    text = printed()
    assert "merges recordings" in text
    assert not re.search(r"lacks \d+ lines", text)
    assert compared["breaks"]


@pytest.mark.parametrize(
    ("topic", "reason"),
    [
        ("sprockets", "lacks a measurement of sprockets that was used live"),
        ("box_pose", "lacks a measurement of box_pose that was used live"),
        (REPORTS, "lacks .* lines of the live estimator's journal"),
    ],
)
def test_estimates_after_a_missing_measurement_are_not_compared(
    one_run: list[Line],
    compare: Compare,
    printed: Callable[[], str],
    topic: str,
    reason: str,
) -> None:
    matches, compared = compare(without(one_run, topic, 6.0, 6.5))
    assert matches is True
    (part,) = compared["parts"]
    assert 5.0 < part["stop"] < 7.0
    assert 200 < compared["estimates"] < 350
    (one,) = compared["breaks"]
    assert one["time"] >= part["stop"]
    assert re.search(reason, one["reason"])
    assert re.search(f"compared from .* to .*; not from .*{reason}", printed())


def test_an_estimate_that_differs_before_a_missing_measurement_is_found(
    one_run: list[Line], compare: Compare
) -> None:
    run = without(one_run, "sprockets", 6.0, 6.5)
    matches, _ = compare(run, "--set", "slip_estimator.vehicle.kinematics.tread=0.74")
    assert matches is False


def test_bag_that_begins_after_the_estimator_is_not_compared(
    one_run: list[Line],
    compare: Compare,
    printed: Callable[[], str],
) -> None:
    """The recorder is restarted: the state of the estimator at its start is unknown."""
    latched = [line for line in one_run if line.topic == PARAMETERS_TOPIC]
    later = [line._replace(log_ns=at_ns(5.0)) for line in latched]
    matches, compared = compare([*later, *since(one_run, 5.0)])
    assert matches is None
    assert compared["parts"] == []
    assert "replay = live: not compared: the bag lacks the first" in printed()


def test_measurements_before_the_first_fix_may_be_missing(inputs: list[Line], compare: Compare) -> None:
    """A recorder discovers topics one after the other; the first fix arrives later."""
    remaining = without(inputs, "box_pose", 0.0, 2.0)
    run = [*remaining, *live(remaining, load_slip_parameters())[0]]
    late = without(without(run, "sprockets", -1.0, 0.8), REPORTS, -1.0, 0.4)
    matches, compared = compare(late)
    assert matches is True
    assert compared["breaks"] == []
    assert compared["estimates"] > 300


OTHER_VEHICLE = {"vehicle.kinematics.tread": 0.8}


@pytest.mark.parametrize(
    ("changes", "lost", "reason"),
    [
        ({}, (), ""),
        ({"gate_probability": 0.9}, (), ""),
        (OTHER_VEHICLE, (), "the estimator was started again with other vehicle.kinematics.tread"),
        ({}, ((1.0, 9.0),), "the bag lacks the parameters of the estimator that was started again"),
    ],
    ids=["the same", "changed at run time", "another vehicle", "unknown parameters"],
)
def test_a_restart_is_compared_if_its_beginning_is_known(
    inputs: list[Line],
    compare: Compare,
    changes: dict[str, float],
    lost: Sequence[tuple[float, float]],
    reason: str,
) -> None:
    run = restarted(inputs, **changes)
    for span in lost:
        run = without(run, PARAMETERS_TOPIC, *span)
    matches, compared = compare(run)
    assert matches is True
    assert [one["reason"] for one in compared["breaks"]] == [reason] * bool(reason)
    first, *later = compared["parts"]
    assert first["stop"] < RESTART_S + 0.5
    assert [part["start"] > RESTART_S + 0.5 for part in later] == [True] * (not reason)


def test_after_a_restart_a_recording_with_gaps_is_compared_again(
    two_runs: list[Line], compare: Compare
) -> None:
    matches, compared = compare(without(two_runs, "sprockets", 3.0, 3.1))
    assert matches is True
    first, second = compared["parts"]
    assert first["stop"] < 3.1 + BEFORE_NS * 1e-9
    assert second["start"] > RESTART_S
    assert len(compared["breaks"]) == 1


def test_replay_of_two_runs_writes_both(
    two_runs: list[Line], inputs: list[Line], tmp_path: Path, compare: Compare
) -> None:
    """The output merged with the inputs is again a recording."""
    made = tmp_path / "made"
    compare(two_runs, "--output", str(made))
    written = in_order_of_journal(made)
    _, second = sorted(m.log_time_ns for m in written if m.topic == f"/{PARAMETERS_TOPIC}")
    written.sort(key=lambda m: m.log_time_ns >= second)
    both = write_lines(tmp_path / "both", inputs, written)
    result = json_of(tmp_path, "replay", both)
    assert result["replay_matches"] is True
    assert len(result["replay_compared"]["parts"]) == 2
