# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip study --estimator soil``: its files, and its use of the cache."""

import json
import math
import re
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import pytest
from fixtures.commands import json_of

from trackslip_sim.study.engine import TABLE_HEADER
from trackslip_sim.study.slip.results import Row
from trackslip_sim.study.soil import study as soil_study
from trackslip_sim.study.soil.parameters import SoilStudyParameters, load_soil_study_parameters
from trackslip_sim.study.soil.results import ChangeRow, SoilRow
from trackslip_sim.study.soil.score import Result
from trackslip_sim.study.soil.trial import Setting, Trial, load_setting
from trackslip_tools.cli.main import main
from trackslip_tools.result_cache import ResultCache
from trackslip_tools.terminal_text import WIDTH, format_for_terminal

COMMAND = ["study", "--estimator", "soil", "--soil", "sand", "dry_clay", "--sigma-xy", "0.05", "--seeds", "2"]


@pytest.fixture
def command(tmp_path: Path) -> list[str]:
    return [*COMMAND, "--workers", "1", "--cache", str(tmp_path / "runs.jsonl")]


class Counted:
    """``run`` without a simulation; raises KeyboardInterrupt at the chosen call."""

    def __init__(self, stop_at: int | None = None) -> None:
        self.trials: list[Trial] = []
        self._stop_at = stop_at

    def __call__(self, trial: Trial, setting: Setting) -> Result:
        if len(self.trials) == self._stop_at:
            raise KeyboardInterrupt
        self.trials.append(trial)
        numbers = dict.fromkeys((field.name for field in fields(Result)), 1.0 + 0.01 * trial.seed)
        intervals = {name: (0.9, 1.1) for name in numbers if name.endswith("_interval")}
        change = {"into": "", "recognised_after": math.nan, "wrong_before": math.nan}
        if trial.scenario == "soil_change":
            change = {"into": "clayey_soil", "recognised_after": math.inf, "wrong_before": 0.2}
        return Result(**(numbers | intervals | change | {"identifiable": True, "reason": ""}))


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Counted:
    counter = Counted()
    monkeypatch.setattr(soil_study, "run_trial", counter)
    return counter


def test_command_writes_rows_and_tables(
    command: list[str], counted: Counted, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--drawn", "--json", str(tmp_path / "rows.json"), "--output", str(tmp_path)]
    assert main([*command, *options]) == 0
    rows = json.loads((tmp_path / "rows.json").read_text())
    cells = [(row["scenario"], row["soil"], row["drawn"]) for row in rows]
    soils = [("field_trial", soil, drawn) for soil in ("sand", "dry_clay") for drawn in (False, True)]
    assert cells == [*soils, ("soil_change", "sand", False), ("soil_change", "sand", True)]
    kinds = [SoilRow] * 4 + [ChangeRow] * 2
    assert [row.keys() for row in rows] == [{field.name for field in fields(kind)} for kind in kinds]
    assert (rows[0]["F_max_inside"], rows[0]["seeds"]) == (2, 2)
    assert rows[4]["recognised_after"] is None  # never: JSON has no infinity
    output, error = capsys.readouterr()
    whole = (tmp_path / "soil_table.md").read_text()
    assert whole.startswith(f"{TABLE_HEADER}\n")
    assert output.startswith(
        "vehicle: pc05\n\n" + format_for_terminal(whole.removeprefix(f"{TABLE_HEADER}\n"))
    )
    assert max(map(len, output.splitlines())) <= WIDTH
    assert error == ""
    lines = [line for line in whole.splitlines() if line.startswith("|")]
    assert len(lines) == 2 + 4 + 2 + 2
    assert len({len(line) for line in lines[:6]}) == len({len(line) for line in lines[6:]}) == 1
    assert " 2/2 " in lines[2]
    assert " never " in lines[8].replace("(", " ").replace(")", " ")
    assert len(counted.trials) == 6 * 2


def timeless(output: str) -> list[str]:
    """The lines of the output, except the one with the duration of the study."""
    return [line for line in output.splitlines() if not re.fullmatch(r"\d+ .* in [\d.]+ s", line)]


def trials_of(
    command: Sequence[str], monkeypatch: pytest.MonkeyPatch, code: int = 0, stop_at: int | None = None
) -> list[Trial]:
    counted = Counted(stop_at)
    monkeypatch.setattr(soil_study, "run_trial", counted)
    assert main(command) == code
    return counted.trials


def test_interrupted_study_resumes_run_by_run(
    command: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    first = trials_of(command, monkeypatch, code=130, stop_at=3)
    second, third = trials_of(command, monkeypatch), trials_of(command, monkeypatch)
    assert (len(first), len(second), len(third)) == (3, 3, 0)
    assert len({*first, *second}) == 6
    whole = timeless(capsys.readouterr().out)
    assert len(trials_of([*command, "--fresh"], monkeypatch)) == 6
    assert whole == 2 * timeless(capsys.readouterr().out)
    more = trials_of([*command, "--seeds", "3"], monkeypatch)
    assert [trial.seed for trial in more] == [2, 2, 2]


@pytest.mark.parametrize(
    "changed",
    [
        ["--set", "soil_estimator.strength.elements=8"],
        ["--set", "slip_estimator.history_window=3.0"],
        ["--sigma-heading", "0.02"],
        ["--duration", "20"],
    ],
)
def test_cache_key_includes_every_setting_of_a_run(
    changed: list[str], command: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert len(trials_of(command, monkeypatch)) == 6
    assert len(trials_of([*command, *changed], monkeypatch)) == 6
    assert len(trials_of(command, monkeypatch)) == 0


def test_both_studies_may_share_a_file(tmp_path: Path) -> None:
    file, result = tmp_path / "pieces.jsonl", Counted()(Trial("sand", 0.05, 0), load_setting())
    ResultCache(file, Result, "--cache").add("a key", result)
    assert not ResultCache(file, Row, "--cache")
    assert repr(ResultCache(file, Result, "--cache")["a key"]) == repr(result)  # nan differs from itself


@pytest.mark.slow
def test_several_processes_give_the_rows_of_one(
    command: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def load(values: dict[str, object]) -> SoilStudyParameters:
        return load_soil_study_parameters(values | {"standstill": 1.0})

    monkeypatch.setattr(soil_study, "load_soil_study_parameters", load)
    rows = []
    for count in ("1", "2"):
        drive = ["--scenario", "straight", "--duration", "2", "--soil", "sand"]
        options = [*drive, "--workers", count, "--fresh"]
        rows.append(json_of(tmp_path, *command, *options))
    assert rows[0] == rows[1]
    assert rows[0][0]["M_r_error"] is None  # no turn
    assert 0.0 < rows[0][0]["driving_thrust_error"] < 0.1
