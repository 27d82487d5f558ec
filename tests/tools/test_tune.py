# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip tune``: files, exit codes, an interruption, and equal results of a cluster and one process."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.stats import chi2

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import open_bag
from trackslip_common.config_files import config_file, node_parameters, read_yaml
from trackslip_common.errors import ExitCode
from trackslip_estimation.slip.parameters import NODE, load_slip_parameters
from trackslip_sim.machine.excavator import simulate_drive
from trackslip_sim.machine.offline import record_drive
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_tools.cli.main import main
from trackslip_tools.replay.run import replay
from trackslip_tools.tuning.evidence import PARAMETERS
from trackslip_tools.tuning.plan import read_plan, value_of
from trackslip_tools.tuning.task import Task

PLAN = """
objective: pose
evaluations: 20
seed: 1
parameters:
  sources.box_pose.timeout: {low: 0.1, high: 3.0, scale: log}
  gate_relaxation: {low: 2.0, high: 20.0}
  sources.*.heading_floor: {low: 1.0e-4, high: 0.3, scale: log}
"""


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    file = tmp_path / "tune.yaml"
    file.write_text(PLAN)
    return file


def tune(bag: Path, plan: Path, output: Path, *options: str) -> int:
    alone = () if "--scheduler" in options else ("--workers", "1")
    named = ("--plan", str(plan), "--output", str(output), "--stop", "12")
    return main(["tune", str(bag), *named, *alone, *options])


@pytest.mark.slow
def test_command_writes_parameters_and_evidence(
    emulated_bag: Path, plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert tune(emulated_bag, plan, out) == ExitCode.DONE
    printed = capsys.readouterr()
    assert "gate_relaxation" in printed.out
    assert printed.err == "setup plausible\n"
    assert {file.name for file in out.iterdir()} == {
        *("slip_estimator.yaml", "evidence.md", "evidence.json", "journal.jsonl")
    }
    evidence = json.loads((out / "evidence.json").read_text())
    layer = node_parameters(read_yaml(out / "slip_estimator.yaml"), NODE, "tuned")
    assert layer["gate_relaxation"] == evidence["values"]["after"]["gate_relaxation"]
    assert load_slip_parameters(layer).timeouts_ns()["box_pose"] == round(
        evidence["values"]["after"]["sources.box_pose.timeout"] * 1e9
    )
    assert main(["replay", str(emulated_bag), "--params", str(out / "slip_estimator.yaml")]) == ExitCode.DONE

    before = (out / "evidence.json").read_text()
    assert tune(emulated_bag, plan, out) == ExitCode.DONE
    assert "going on" in capsys.readouterr().err
    assert (out / "evidence.json").read_text() == before


@pytest.mark.slow
def test_tuning_with_the_wrong_vehicle_fails(
    emulated_bag: Path, plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert tune(emulated_bag, plan, out, "--vehicle", "excavator_20t", "--stop", "40") == ExitCode.FAILED
    assert "correct it (trackslip check)" in " ".join(capsys.readouterr().out.split())


def test_ctrl_c_leaves_the_journal(
    emulated_bag: Path, plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    score, calls = Task.score, []

    def interrupted(self: Task, values: dict[str, float]) -> object:
        calls.append(values)
        if len(calls) > 10:
            raise KeyboardInterrupt
        return score(self, values)

    monkeypatch.setattr(Task, "score", interrupted)
    assert tune(emulated_bag, plan, tmp_path / "out") == ExitCode.INTERRUPTED
    assert [file.name for file in (tmp_path / "out").iterdir()] == ["journal.jsonl"]
    assert len((tmp_path / "out" / "journal.jsonl").read_text().splitlines()) == 10


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--scheduler", "tcp://127.0.0.1:1"), "no Dask scheduler answers"),
        (("--reference", "nothing"), "nothing"),
        (("--plan", "nothing.yaml"), "file 'nothing.yaml' not found"),
        (("--withhold", "box_pose"), "to start from"),
        (("--stop", "3"), "the tracks do not move"),
    ],
)
def test_bad_input_is_refused_in_one_line(
    emulated_bag: Path,
    plan: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    options: tuple[str, ...],
    words: str,
) -> None:
    monkeypatch.setattr("trackslip_tools.workers._SCHEDULER_TIMEOUT_S", 1.0)
    assert tune(emulated_bag, plan, tmp_path / "out", *options) == ExitCode.BAD_INPUT
    *before, error = capsys.readouterr().err.splitlines()
    assert words in error
    assert before in ([], ["setup plausible"])
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_two_workers_of_a_cluster_find_what_one_process_finds(
    emulated_bag: Path, plan: Path, tmp_path: Path
) -> None:
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, protocol="tcp"
    ) as cluster:
        address = cluster.scheduler_address
        assert tune(emulated_bag, plan, tmp_path / "cluster", "--scheduler", address) == ExitCode.DONE
    assert tune(emulated_bag, plan, tmp_path / "alone") == ExitCode.DONE
    for name in ("slip_estimator.yaml", "evidence.json"):
        assert (tmp_path / "cluster" / name).read_text() == (tmp_path / "alone" / name).read_text()


SLALOMS = [("slalom", "clayey_soil"), ("slalom", "sandy_loam"), ("thesis", "clayey_soil"), ("slalom", "sand")]
TRIALS = [("field_trial", soil) for soil in ("sand", "sandy_loam", "dry_clay", "clayey_soil")]
LONG = (pytest.mark.slow, pytest.mark.timeout(1200))
APART = 7.0  # s, the longest correlation time of the pose's NEES


def recorded(scenario: str, soil: str, seed: int, path: Path) -> Path:
    p = load_emulator_parameters({"scenario": scenario, "soil": soil, "seed": seed})
    record_drive(p, simulate_drive(p), path)
    return path


def start_off(plan: Path, file: Path, factor: float) -> Path:
    """Write process noise times ``factor``; if it is reduced, noise of the fixes is ten times too large."""
    defaults = load_slip_parameters()
    names = [name for name in read_plan(plan).bounds if "*" not in name]
    layer: dict[str, Any] = {name: factor * value_of(defaults, name) for name in names}
    if factor < 1.0:
        layer |= {"sources.box_pose.position_floor": 0.07, "sources.box_pose.heading_floor": 0.28}
    file.write_text(yaml.safe_dump({NODE: {"ros__parameters": layer}}))
    return file


def replayed(bag: Path, *layers: Path) -> tuple[float, float, float]:
    """Errors of position, m, and heading, rad, and NEES of the published estimates."""
    p = load_slip_parameters(*(node_parameters(read_yaml(layer), NODE, str(layer)) for layer in layers))
    with open_bag(bag) as opened:
        result = replay(opened, p, InputFilters(), None)
    errors = result.scores["filter"]
    assert errors is not None
    assert result.nees is not None
    return errors.position, errors.heading, result.nees


@pytest.mark.parametrize(
    ("drives", "factor", "evaluations"),
    [
        pytest.param(SLALOMS, 0.1, 60, id="slaloms", marks=LONG),
        pytest.param(TRIALS, 0.1, 300, id="trials_too_small", marks=LONG),
        pytest.param(TRIALS, 10.0, 300, id="trials_too_large", marks=LONG),
    ],
)
def test_tuning_corrects_tenfold_wrong_noise_on_unseen_bag(
    drives: list[tuple[str, str]], factor: float, evaluations: int, tmp_path: Path
) -> None:
    """On the three bags the error falls to 0.75 or less, although the filter itself adapts much of the noise.

    The covariances are consistent, and the position on an unseen bag improves as well.
    """
    bags = [recorded(*names, 11 + k, tmp_path / f"bag{k}") for k, names in enumerate(drives)]
    plan, out = tmp_path / "tune.yaml", tmp_path / "out"
    default_plan = read_yaml(config_file("tune.yaml")) | {"evaluations": evaluations}
    plan.write_text(yaml.safe_dump(default_plan, sort_keys=False))
    start = start_off(plan, tmp_path / "off.yaml", factor)
    options = ("--plan", str(plan), "--params", str(start), "--output", str(out), "--no-cross-validation")
    assert main(["tune", *map(str, bags[:3]), *options]) == ExitCode.DONE

    before = np.array([replayed(bag, start) for bag in bags])
    after = np.array([replayed(bag, start, out / PARAMETERS) for bag in bags])
    assert np.hypot.reduce(after[:3, 0]) < 0.75 * np.hypot.reduce(before[:3, 0])
    for bag, nees in zip(bags[:3], after[:3, 2], strict=True):
        with open_bag(bag) as opened:
            independent = opened.duration_s / APART
        low, high = chi2.ppf((0.025 / 3.0, 1.0 - 0.025 / 3.0), 3.0 * independent) / independent
        assert low < nees < high
    assert after[3, 0] < before[3, 0]
    assert after[3, 1] < 1.1 * before[3, 1]
    assert abs(np.log(after[3, 2] / 3.0)) < abs(np.log(before[3, 2] / 3.0))
