# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip study``: files and use of the cache of the slip study, and refusals of both studies."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trackslip_common.compiling import DESK_TEXT
from trackslip_common.parameters import to_flat
from trackslip_estimation import attitude, kalman, slip, terramechanics
from trackslip_estimation.slip import bank, sources
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_sim import truth
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_sim.study.engine import Study
from trackslip_sim.study.slip import study as slip_study
from trackslip_sim.study.slip.figures import run_figures, terrain_figure
from trackslip_sim.study.slip.parameters import cells, load_study_parameters
from trackslip_sim.study.slip.results import Row
from trackslip_sim.study.slip.study import SlipStudy
from trackslip_sim.study.soil.study import SoilStudy
from trackslip_tools.cli.main import main
from trackslip_tools.result_cache import source_files
from trackslip_tools.terminal_text import WIDTH

KEYS = {
    *("truth", "soil", "filter", "sigma_xy", "sigma_omega", "seeds"),
    *("position_rmse", "position_bound", "heading_rmse", "heading_bound"),
    *("slip_rmse", "slip_bound", "alpha_rmse", "alpha_bound"),
    *("nees_pose", "nees_pose_bounds", "nees_slip", "nees_slip_bounds", "nis_pose", "nis_yaw_rate"),
}
SHORT = ["--scenario", "slalom", "--duration", "9", "--settling", "6", "--seeds", "2", "--soil", "sand"]


@pytest.fixture
def command(tmp_path: Path) -> list[str]:
    return ["study", *SHORT, "--workers", "1", "--cache", str(tmp_path / "cells.jsonl")]


@pytest.mark.slow
def test_command_writes_rows_table_and_figures(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--sigma-xy", "0.01", "0.05", "--json", str(tmp_path / "rows.json"), "--output", str(tmp_path)]
    assert main([*command, *options]) == 0
    rows = json.loads((tmp_path / "rows.json").read_text())
    grid = [(r["truth"], r["filter"], r["sigma_xy"]) for r in rows]
    assert grid == [(t, f, s) for t in ("shear", "matched") for f in ("ekf", "daf") for s in (0.01, 0.05)]
    assert all(row.keys() >= KEYS and row["soil"] == "sand" and row["seeds"] == 2 for row in rows)
    assert all(0.0 < row["position_rmse"] < 10.0 * row["position_bound"] for row in rows)
    output, error = capsys.readouterr()
    assert (tmp_path / "study_table.md").is_file()
    assert max(map(len, output.splitlines())) <= WIDTH
    assert error.removeprefix(f"{DESK_TEXT}\n") == ""  # no progress bar in a pipe
    figures = {path.name for path in (tmp_path / "figures").iterdir()}
    assert figures == {
        f"study_{what}_{truth}.png" for what in ("rmse", "nees") for truth in ("shear", "matched")
    }
    assert main([*command, *options]) == 0  # replaces the earlier files


def test_cache_key_of_a_drawn_cell_includes_the_source_defaults(monkeypatch: pytest.MonkeyPatch) -> None:
    """The stamp error of an unlisted source is not a parameter of the estimator itself."""
    (cell,) = {cell for cell in _drawn().cells if cell.soil == "sand"}
    before = _drawn().depends_on(cell)
    assert before == _drawn().depends_on(cell)
    defaults = sources._defaults()
    other = {**defaults, "pose_sources": {**defaults["pose_sources"], "stamp_error": 0.06}}
    monkeypatch.setattr(sources, "_defaults", lambda: other)
    assert before != _drawn().depends_on(cell)


@pytest.mark.parametrize("study", [SlipStudy, SoilStudy])
def test_cache_key_includes_all_sources_of_filters_and_truth(study: type[Study[Any, Any]]) -> None:
    used = source_files((attitude, kalman, slip, terramechanics, truth))
    assert bank.__file__ in map(str, used)
    assert set(used) <= set(source_files(study.SOURCES))


def test_cache_key_of_a_slip_cell_includes_the_noise_of_the_emulated_sensors() -> None:
    study = _drawn()
    noise = study.depends_on(next(iter(study.cells)))["noise"]
    assert noise == to_flat(load_emulator_parameters({}).noise)


def _drawn() -> SlipStudy:
    parameters = {"truths": ["drawn"], "filters": ["ekf"], "sigma_xy": [0.01], "sigma_omega": [0.01]}
    return SlipStudy(parameters, [])


def test_cells_on_terrain_have_a_table_and_a_figure_of_their_own(tmp_path: Path) -> None:
    on_hill = _row(terrain="hill", ignoring_position_rmse=6.0, ignoring_nees_pose=30.0)
    still = replace(on_hill, soil="dry_clay", turning_slip_rmse=math.nan, ignoring_turning_slip_rmse=None)
    still = replace(still, turning_slip_bound=math.nan)
    study = SlipStudy({"terrains": ["flat", "hill"]}, [])
    (tmp_path / "figures").mkdir()
    study.write([replace(on_hill, ignoring_turning_slip_rmse=2.0), still, _row()], tmp_path)
    written = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.*")}
    assert written == set(study.files()) == {"slope_table.md", "figures/study_slopes.png"}
    figure = terrain_figure([replace(on_hill, ignoring_turning_slip_rmse=2.0), still])
    drawn = [[float(y) for line in axes.lines[1:] for y in line.get_ydata()] for axes in figure.axes]
    np.testing.assert_equal(drawn, [[1.0, 6.0]] * 2 + [[1.0, 2.0], [math.nan] * 2] + [[1.0 / 3.0, 10.0]] * 2)


def test_cached_rows_equal_computed_ones(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "deep" / "cells.jsonl"
    parameters = {"scenario": ["slalom"], "duration": 9.0, "settling": 6.0, "seeds": 2}
    parameters |= {"truths": ["matched"], "soils": ["sand"], "filters": ["ekf"], "sigma_xy": [0.05]}

    def study(*settings: str, fresh: bool = False, **changed: object) -> list[Row]:
        return list(SlipStudy({**parameters, **changed}, settings).run(file, fresh=fresh))

    def interrupt(*_: Any) -> Row:
        raise KeyboardInterrupt

    computed = study()
    monkeypatch.setattr(slip_study, "evaluate", interrupt)
    assert study() == computed
    for changed in ({"seeds": 3}, {"settling": 5.0}, {"fresh": True}):
        with pytest.raises(KeyboardInterrupt):
            study(**changed)
    with pytest.raises(KeyboardInterrupt):
        study("slip_estimator.encoder_resolution=1e-3")
    file.write_text(file.read_text()[:-20], encoding="utf-8")  # truncated, as by a power cut
    with pytest.raises(KeyboardInterrupt):
        study()


REFUSED = [
    ("slip soil", ["--soil", "mud"], "soil: 'mud' is unknown"),
    ("slip soil", ["--soil", "lete_sand"], "mu_r"),
    ("slip soil", ["--scenario", "waltz"], "scenario: 'waltz' is unknown"),
    ("slip soil", ["--sigma-xy", "0"], "sigma_xy"),
    ("slip soil", ["--sigma-xy", "nan"], "sigma_xy"),
    ("slip soil", ["--seeds", "0"], "seeds"),
    ("slip soil", ["--workers", "0"], "--workers"),
    ("slip soil", ["--json", "/nowhere/rows.json"], "no such folder"),
    ("slip soil", ["--output", "/dev/null/x"], "--output"),
    ("slip soil", ["--cache", "/dev/null/x"], "--cache"),
    ("slip", ["--sigma-omega", "-1"], "sigma_omega"),
    (
        "slip",
        ["--settling", "9", "--duration", "9"],
        "settling: 9 s is refused; accepted: up to 1 s less than",
    ),
    ("slip", ["--truth", "drawn", "--terrain", "hill"], "terrains: not with truth drawn"),
    ("slip", ["--filter", "ukf"], "--filter"),
    ("slip", ["--set", "slip_estimator.mass=3"], "mass"),
    ("slip", ["--scenario", "slalom", "thesis"], "--scenario: 'thesis' is one too many; accepted: one"),
    ("slip", ["--drawn"], "--drawn: does not go with --estimator slip"),
    ("slip", ["--set", "soil_estimator.low_reserve=0.2"], "slip_estimator.<parameter>=<value>"),
    ("soil", ["--filter", "ekf"], "--filter: does not go with --estimator soil"),
    ("soil", ["--truth", "matched"], "--truth: does not go with --estimator soil"),
    ("soil", ["--sigma-omega", "0.1"], "--sigma-omega: does not go with --estimator soil"),
    ("soil", ["--settling", "5"], "--settling: does not go with --estimator soil"),
    ("soil", ["--duration", "-1"], "duration"),
    ("soil", ["--set", "soil_estimator.mass=3"], "mass"),
    ("soil", ["--set", "box_localizer.rays=3"], "--set box_localizer.rays=3"),
    ("box", [], "--estimator"),
]


@pytest.mark.parametrize(
    ("estimator", "options", "message"), [(one, *case) for names, *case in REFUSED for one in names.split()]
)
def test_bad_input_is_one_line(
    estimator: str, options: list[str], message: str, tmp_path: Path, refuse: Callable[..., str]
) -> None:
    command = ["study", "--estimator", estimator, "--cache", str(tmp_path / "cells.jsonl")]
    assert message in refuse(*command, *options)


def test_the_table_marks_what_is_outside() -> None:
    row = _row(nees_pose=5.0, nees_slip=1.0)
    lines = SlipStudy({}, []).markdown([row, replace(row, truth="shear", nees_pose=3.0)]).splitlines()
    assert len({len(line) for line in lines[:4]}) == 1
    assert ("5.00 ↑" in lines[2], "1.00 ↓" in lines[2], "3.00 " in lines[3]) == (True, True, True)
    assert "↑" not in lines[3]


def _row(**values: Any) -> Row:
    numbers: dict[str, Any] = dict.fromkeys(Row.__dataclass_fields__, 1.0) | {
        "truth": "matched",
        "soil": "sand",
        "filter": "ekf",
        "scenario": "thesis",
        "seeds": 100,
        "terrain": "",
        **{f"{name}_bounds": (2.5, 3.5) for name in ("nees_pose", "nees_slip", "nis_pose", "nis_yaw_rate")},
    }
    return Row(**(numbers | values))


def test_single_runs_are_drawn_under_each_condition_of_the_thesis() -> None:
    p = load_study_parameters({"scenario": "slalom", "duration": 5.0, "settling": 2.0, "soils": ["sand"]})
    drawn = dict(run_figures(p, load_slip_parameters()))
    assert list(drawn) == ["fig_6_3", "fig_6_5", "fig_6_7", "fig_6_9", "fig_6_11", "fig_6_13"]
    assert all(len(figure.axes) == 3 for figure in drawn.values())


def test_the_grid_has_every_combination_once() -> None:
    p = load_study_parameters({"sigma_omega": [0.01, 0.1]})
    grid = list(cells(p))
    assert len(grid) == len(set(grid)) == 2 * 4 * 2 * 4 * 2


def test_a_row_on_terrain_has_a_table_of_its_own_beside_those_without() -> None:
    sloping = {"terrain": "slope_15", "ignoring_nees_pose": 9.0}
    text = SlipStudy({}, []).markdown([_row(), _row(**sloping), _row(**sloping, slip_bound=float("nan"))])
    assert "slope 15" in text
    assert "flat: position ×" in text
    assert "9.0" in text


def test_immobile_machine_has_no_slips_in_the_table() -> None:
    stuck = _row(terrain="slope_15", turning_slip_rmse=float("nan"), turning_slip_bound=float("nan"))
    assert "–" in SlipStudy({}, []).markdown([stuck])
