# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Results replace earlier results only: any other file named by mistake is kept."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from trackslip_common.atomic_files import write_atomically
from trackslip_common.errors import InputError
from trackslip_sim.study.engine import Study
from trackslip_sim.study.slip.results import Row
from trackslip_tools.cli.outputs import PAGE_PREFIX, refuse_foreign_file
from trackslip_tools.result_cache import ResultCache
from trackslip_tools.tuning.evidence import FILE_PREFIXES, PARAMETERS

Refuse = Callable[..., str]
MINE = "years of work\n"


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    path = tmp_path / "thesis.tex"
    path.write_text(MINE, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("command", "option"),
    [
        *(("replay", "--json"), ("smooth", "--json"), ("report", "--output")),
        *(("calibrate", "--output"), ("calibrate", "--json")),
    ],
)
def test_text_of_the_user_is_not_replaced_by_a_result(
    bag: Path, mine: Path, refuse: Refuse, command: str, option: str
) -> None:
    assert "holds something else, and is not replaced" in refuse(command, bag, option, mine)
    assert mine.read_text(encoding="utf-8") == MINE


@pytest.mark.parametrize("name", FILE_PREFIXES)
def test_parameters_of_the_user_are_not_replaced_by_tuned_ones(
    bag: Path, tmp_path: Path, refuse: Refuse, name: str
) -> None:
    """As with ``tune --output config``."""
    (tmp_path / name).write_text(MINE, encoding="utf-8")
    assert "is not replaced" in refuse("tune", bag, "--output", tmp_path)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir() if path.is_file()] == [(name, MINE)]


@pytest.mark.parametrize("name", ["index.html", "1.html"])
def test_pages_of_the_user_are_not_replaced_by_those_of_a_folder(
    bag: Path, tmp_path: Path, refuse: Refuse, name: str
) -> None:
    site = tmp_path / "site"
    site.mkdir()
    (site / name).write_text("<!DOCTYPE html>\n<title>My site</title>", encoding="utf-8")
    (site / "own.html").write_text(MINE, encoding="utf-8")
    assert "is not replaced" in refuse("report", bag.parent, "--output", site)
    assert sorted(path.name for path in site.iterdir()) == sorted([name, "own.html"])


STUDY = ("study", "--seeds", "1", "--soil", "sand", "--cache")


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ((), "study_table.md"),
        ((), "figures/study_rmse_shear.png"),
        (("--terrain", "hill"), "slope_table.md"),
        (("--terrain", "hill"), "figures/study_slopes.png"),
        (("--estimator", "soil"), "soil_table.md"),
    ],
)
def test_tables_and_figures_of_the_user_are_not_replaced_by_a_study(
    tmp_path: Path, refuse: Refuse, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...], name: str
) -> None:
    monkeypatch.setattr(Study, "run", lambda *_, **__: pytest.fail("refused after the work"))
    theirs = tmp_path / "docs" / name
    theirs.parent.mkdir(parents=True)
    theirs.write_text("| soil | what I measured |\n", encoding="utf-8")
    before = sorted(tmp_path.rglob("*"))
    line = refuse(*STUDY, tmp_path / "cache", *options, "--output", tmp_path / "docs")
    assert f"{name}' holds something else, and is not replaced" in line
    assert theirs.read_text(encoding="utf-8") == "| soil | what I measured |\n"
    assert sorted(tmp_path.rglob("*")) == before
    theirs.unlink()
    theirs.mkdir()
    line = refuse(*STUDY, tmp_path / "cache", *options, "--output", tmp_path / "docs")
    assert f"{name}' cannot be written (it is a directory)" in line


def test_earlier_results_and_empty_files_are_replaced(tmp_path: Path) -> None:
    before = tmp_path / "report.html"
    for content in (f"{PAGE_PREFIX} -->", "", PAGE_PREFIX):
        before.write_text(content, encoding="utf-8")
        refuse_foreign_file("output", before, PAGE_PREFIX)
    for path in (Path(os.devnull), tmp_path / "new.html", tmp_path):
        refuse_foreign_file("output", path, PAGE_PREFIX)
    assert set(FILE_PREFIXES) > {PARAMETERS}


@pytest.mark.parametrize("holds", ["text", "a pipe", "8 GB"])
def test_what_is_no_cache_is_refused_without_blocking_and_kept(mine: Path, holds: str) -> None:
    if holds == "a pipe":
        mine.unlink()
        os.mkfifo(mine)
    elif holds == "8 GB":
        os.truncate(mine, 2**33)
    before = mine.stat()
    with pytest.raises(InputError, match="holds something else"):
        ResultCache(mine, Row, "--cache")
    after = mine.stat()
    assert (after.st_mode, after.st_size) == (before.st_mode, before.st_size)
    if holds != "a pipe":
        with mine.open(encoding="utf-8") as file:
            assert file.read(len(MINE)) == MINE


def test_links_and_devices_are_written_through(tmp_path: Path, mine: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to(mine)
    write_atomically(link, "through the link")
    write_atomically(Path(os.devnull), "nowhere")
    assert link.is_symlink()
    assert mine.read_text(encoding="utf-8") == "through the link"
