# SPDX-License-Identifier: Apache-2.0
"""``trackslip tune``: files, exit codes, an interruption, and a cluster that finds what one process finds."""

import json
from pathlib import Path

import pytest

from trackslip_common.config_files import node_parameters, read_yaml
from trackslip_common.errors import ExitCode
from trackslip_estimation.cli.main import main
from trackslip_estimation.slip_parameters import NODE, load_slip_parameters
from trackslip_estimation.tuning.task import Task

PLAN = """
objective: pose
evaluations: 24
seed: 1
parameters:
  pose_timeouts: {low: 0.1, high: 3.0, scale: log}
  gate_relaxation: {low: 2.0, high: 20.0}
"""


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    file = tmp_path / "tune.yaml"
    file.write_text(PLAN)
    return file


def tune(bag: Path, plan: Path, output: Path, *options: str) -> int:
    return main(["tune", str(bag), "--plan", str(plan), "--output", str(output), "--stop", "20", *options])


def test_it_leaves_parameters_and_evidence(
    emulated_bag: Path, plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert tune(emulated_bag, plan, out) == ExitCode.DONE
    printed = capsys.readouterr()
    assert "gate_relaxation" in printed.out
    assert printed.err == ""
    assert {file.name for file in out.iterdir()} == {
        *("slip_estimator.yaml", "evidence.md", "evidence.json", "journal.jsonl")
    }
    found = json.loads((out / "evidence.json").read_text())
    layer = node_parameters(read_yaml(out / "slip_estimator.yaml"), NODE, "tuned")
    assert layer["gate_relaxation"] == found["values"]["after"]["gate_relaxation"]
    assert load_slip_parameters(layer).pose_timeouts == (found["values"]["after"]["pose_timeouts"],)
    assert main(["replay", str(emulated_bag), "--params", str(out / "slip_estimator.yaml")]) == ExitCode.DONE

    before = (out / "evidence.json").read_text()
    assert tune(emulated_bag, plan, out) == ExitCode.DONE
    assert "going on" in capsys.readouterr().err
    assert (out / "evidence.json").read_text() == before


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
    assert tune(emulated_bag, plan, tmp_path / "out", "--jobs", "1") == ExitCode.INTERRUPTED
    assert [file.name for file in (tmp_path / "out").iterdir()] == ["journal.jsonl"]
    assert len((tmp_path / "out" / "journal.jsonl").read_text().splitlines()) == 11


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--scheduler", "tcp://127.0.0.1:1"), "no Dask scheduler answers"),
        (("--reference", "nothing"), "nothing"),
        (("--plan", "nothing.yaml"), "file 'nothing.yaml' not found"),
        (("--withhold", "box_pose"), "to start from"),
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
    monkeypatch.setattr("trackslip_estimation.tuning.workers._ANSWERS", 1.0)
    assert tune(emulated_bag, plan, tmp_path / "out", *options) == ExitCode.BAD_INPUT
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_two_workers_of_a_cluster_find_what_one_process_finds(
    emulated_bag: Path, plan: Path, tmp_path: Path
) -> None:
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, protocol="tcp"
    ) as cluster:
        address = cluster.scheduler_address
        assert tune(emulated_bag, plan, tmp_path / "cluster", "--scheduler", address) == ExitCode.DONE
    assert tune(emulated_bag, plan, tmp_path / "alone", "--jobs", "1") == ExitCode.DONE
    for name in ("slip_estimator.yaml", "evidence.json"):
        assert (tmp_path / "cluster" / name).read_text() == (tmp_path / "alone" / name).read_text()
