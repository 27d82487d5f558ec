# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The smoother on an emulated drive: better than the filter, mainly in outages; consistent at breaks."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.commands import json_of
from fixtures.made_bags import write_messages

from trackslip_bags.reader import open_bag
from trackslip_common.arrays import Rows
from trackslip_common.errors import ExitCode, InputError
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.log import make_log
from trackslip_estimation.slip.measurements import SET_POSE, Measurement, PoseFix, Sprockets
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, load_slip_parameters
from trackslip_estimation.slip.records import to_records
from trackslip_tools.cli.main import main
from trackslip_tools.smoothing.smoothing import Smoothed, smooth

S = 1_000_000_000
SIGMAS = (0.05, 0.05, 0.05)  # m, m, rad
OUTAGE = (22 * S, 34 * S)  # of the fixes, during turns both ways


@pytest.fixture(scope="module")
def outage(log: Any) -> Smoothed:
    return smoothed_of(without(log.measurements, PoseFix, *OUTAGE))


def smoothed_of(measurements: list[Measurement], p: SlipEstimatorParameters | None = None) -> Smoothed:
    """All blocks of the smoother, concatenated."""
    p = p or load_slip_parameters()
    blocks = list(smooth(make_log(to_records(measurements, SlipEstimator(p).sources), p), p))
    return Smoothed(*(np.concatenate(parts) for parts in zip(*blocks, strict=True)))


def without(inputs: tuple[Measurement, ...], kind: type, start_ns: int, stop_ns: int) -> list[Measurement]:
    return [m for m in inputs if not (isinstance(m, kind) and start_ns <= m.stamp_ns < stop_ns)]


def errors(estimates: Rows, log: Any, start_ns: int = 0, stop_ns: int = 2**62) -> tuple[float, float]:
    """RMS errors of position, m, and heading, rad."""
    stamps_ns = estimates["stamp_ns"]
    inside = (start_ns <= stamps_ns) & (stamps_ns < min(stop_ns, int(log.truth_ns[-1])))
    differences = estimates["pose"][inside] - log.true_pose(stamps_ns[inside])
    differences[:, 2] = np.angle(np.exp(1j * differences[:, 2]))
    position, heading = (
        np.sqrt(np.mean(np.sum(differences[:, :2] ** 2, axis=1))),
        np.sqrt(np.mean(differences[:, 2] ** 2)),
    )
    return float(position), float(heading)


def sparse_noisy_fixes(measurements: list[Measurement], seed: int) -> list[Measurement]:
    """The measurements with every fourth fix, at 5 cm noise."""
    rng = np.random.default_rng(seed)
    fixes = [m for m in measurements if isinstance(m, PoseFix)][::4]
    noisy = [
        replace(m, pose=m.pose + rng.normal(0.0, SIGMAS), covariance=np.diag(np.square(SIGMAS)))
        for m in fixes
    ]
    return [m for m in measurements if not isinstance(m, PoseFix)] + list(noisy)


def test_smoother_is_better_than_the_filter_and_much_better_in_an_outage(log: Any) -> None:
    measurements = without(log.measurements, PoseFix, *OUTAGE)
    runs = [smoothed_of(sparse_noisy_fixes(measurements, seed)) for seed in range(2)]
    for span, gain in (((0, 2**62), 0.8), (OUTAGE, 0.7)):
        filtered = np.mean([errors(run.filtered, log, *span) for run in runs], axis=0)
        smoothed = np.mean([errors(run.smoothed, log, *span) for run in runs], axis=0)
        assert (smoothed < gain * filtered).all()


def test_smoothed_covariance_is_consistent_and_below_the_filtered_one(log: Any, outage: Smoothed) -> None:
    """Within 1e-4: yaw rates have the gain of a Schmidt filter, which does not minimise the variance."""
    filtered, smoothed = (estimates["pose_covariance"] for estimates in outage)
    reduction = np.linalg.eigvalsh(filtered - smoothed)[:, 0] / np.trace(filtered, axis1=1, axis2=2)
    assert reduction.min() > -1e-4
    estimates = outage.smoothed
    error = estimates["pose"] - log.true_pose(estimates["stamp_ns"])
    error[:, 2] = np.angle(np.exp(1j * error[:, 2]))
    nees = (error * np.linalg.solve(estimates["pose_covariance"], error[..., np.newaxis])[..., 0]).sum(axis=1)
    assert np.mean(nees) < 6.0, "3 if consistent; one drive's errors are few and go together"


def test_smoother_ends_in_the_state_of_the_filter_for_any_order_of_arrival(
    log: Any, outage: Smoothed
) -> None:
    measurements = without(log.measurements, PoseFix, *OUTAGE)
    shuffled = [measurements[i] for i in np.random.default_rng(3).permutation(len(measurements))]
    again = smoothed_of(shuffled)
    live = SlipEstimator(load_slip_parameters())
    for measurement in sorted(measurements, key=lambda m: m.stamp_ns):
        live.process(measurement)
    for estimates in (outage.smoothed, again.smoothed, outage.filtered):
        np.testing.assert_allclose(estimates[-1]["pose"], live.estimate().pose, atol=1e-9)
    np.testing.assert_array_equal(again.smoothed["pose"], outage.smoothed["pose"])


def test_set_pose_does_not_change_the_path_before_it(log: Any) -> None:
    at_ns = 25 * S + 1
    moved = log.true_pose(at_ns) + np.array((3.0, 0.0, 0.0))
    manual_pose = PoseFix(SET_POSE, at_ns, moved, np.diag((1e-4, 1e-4, 1e-4)))
    fixes = without(log.measurements, PoseFix, at_ns, 2**62)
    with_manual_pose = smoothed_of([*fixes, manual_pose]).smoothed
    without_manual_pose = smoothed_of([m for m in fixes if m.stamp_ns < at_ns]).smoothed
    before = with_manual_pose["pose"][with_manual_pose["stamp_ns"] < at_ns]
    assert np.abs(before - without_manual_pose["pose"][: len(before)]).max() < 1e-6
    assert abs(with_manual_pose["pose"][-1, 0] - log.true_pose(with_manual_pose["stamp_ns"][-1])[0]) > 1.0


def test_silent_sprockets_leave_a_gap_and_no_nonsense(log: Any) -> None:
    gap = (20 * S, 22 * S)
    result = smoothed_of(without(log.measurements, Sprockets, *gap))
    stamps_ns = result.smoothed["stamp_ns"]
    assert not ((gap[0] <= stamps_ns) & (stamps_ns < gap[1])).any()
    assert np.isfinite(result.smoothed["pose"]).all()
    assert np.isfinite(result.smoothed["slips"]).all()
    filtered, smoothed = (errors(estimates, log) for estimates in result)
    assert smoothed[0] < filtered[0]


@pytest.mark.parametrize("model", ["icr", pytest.param("free_slips", marks=pytest.mark.slow)])
def test_smoother_uses_the_ekf_for_every_model(log: Any, model: str) -> None:
    p = load_slip_parameters({"model": model, "filter": "daf"})
    result = smoothed_of(without(log.measurements, PoseFix, *OUTAGE), p)
    filtered, smoothed = (errors(estimates, log) for estimates in result)
    assert smoothed[0] < filtered[0]
    again = smoothed_of(without(log.measurements, PoseFix, *OUTAGE), replace(p, filter="ekf"))
    np.testing.assert_array_equal(again.smoothed["pose"][100], result.smoothed["pose"][100])


def test_smoothing_without_a_fix_is_refused(log: Any) -> None:
    with pytest.raises(InputError, match="to start from"):
        smoothed_of([m for m in log.measurements if not isinstance(m, PoseFix)])


@pytest.mark.slow
def test_the_command_writes_a_bag_and_a_summary(emulated_bag: Path, tmp_path: Path) -> None:
    output = tmp_path / "smoothed"
    summary = json_of(tmp_path, "smooth", emulated_bag, "--withhold", "box_pose:22:34", "--output", output)
    assert summary["reference"] == "truth/odometry"
    for name in ("position", "heading"):
        assert 0.0 < summary["smoother"][name] < summary["filter"][name]
    assert 0.0 < summary["smoother"]["slip"] < 0.1
    with open_bag(output) as bag:
        counts = {topic: info.count for topic, info in bag.topics.items()}
    number = summary["estimates"]
    assert counts == {
        "/slip_estimator/parameters": 1,
        "/smoothed/odometry": number,
        "/smoothed/track_slip": number,
    }


def test_command_without_a_start_reports_no_estimate(
    emulated_bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["smooth", str(emulated_bag), "--withhold", "box_pose"]) == ExitCode.FAILED
    assert "no estimate" in capsys.readouterr().out


def test_the_command_refuses_a_clock_that_went_back(
    emulated_bag: Path, tmp_path: Path, refuse: Callable[..., str]
) -> None:
    """A bag played twice into one recording."""
    with open_bag(emulated_bag) as bag:
        once, later_ns = list(bag.messages(("sprockets", "box_pose"))), bag.end_ns - bag.start_ns + 1
    again = [m._replace(log_time_ns=m.log_time_ns + later_ns) for m in once]
    twice = write_messages(tmp_path / "twice", [*once, *again])
    assert "the clock goes back by 5" in refuse("smooth", twice)
    assert main(["smooth", str(twice), "--stop", "50"]) == ExitCode.DONE
