# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Commands and Python of the pages for newcomers run as written, in order and in one folder.

``trackslip`` runs in this process, so that libraries load once. tests/scripts/test_wheel.py runs the same
lines in a shell.
"""

import shlex
import shutil
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from fixtures.documents import ROOT, code_of
from fixtures.newcomer import write_log

from trackslip_tools.cli.main import main

README, TUTORIAL, PYTHON = (ROOT / name for name in ("README.md", "docs/tutorial.md", "docs/python.md"))
NOT_RUN = {  # with the reason
    "make demo": "drives 40 s with ROS: tests/graph/test_demo.py; its bag is one of bags/ here",
    "make test": "runs this test",
    ". .venv/bin/activate": "the environment of the tests",
    "pip install dist/trackslip-*.whl": "takes a minute: tests/scripts/test_wheel.py",
    "trackslip demo": "simulates half a minute: tests/scripts/test_wheel.py",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The working directory with the files that a reader already has: the demo's bag and a log."""
    place = tmp_path_factory.mktemp("reader")
    (place / "out/demo").mkdir(parents=True)
    shutil.copytree(ROOT / "bags/slalom_sand", place / "out/demo/bag")
    write_log(place / "log.csv")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        yield place


def run_page(page: Path) -> None:
    """Run all code of a page; its Python shares one namespace, its YAML is the mapping of the line below.

    A line that occurs on several pages runs once.
    """
    names: dict[str, object] = {}
    for code in code_of(page):
        if code.language == "python":
            exec(compile(code.text, str(page), "exec"), names)
        elif code.language == "yaml":
            Path("mine.yaml").write_text(code.text, encoding="utf-8")
        else:
            run_line(code.text)


@cache
def run_line(line: str) -> None:
    words = shlex.split(line, comments=True)
    if shlex.join(words) not in {shlex.join(shlex.split(one)) for one in NOT_RUN}:
        assert words[0] == "trackslip", line
        assert main(words[1:]) == 0, line


@pytest.mark.parametrize(
    ("page", "files"),
    [
        (README, ["out/report.html", "path.tum"]),
        (TUTORIAL, ["out/report.html", "out/mine/metadata.yaml", "out/mine.html"]),
        (PYTHON, ["digger.yaml", "path.tum", "path.geojson"]),
    ],
    ids=lambda value: value.stem if isinstance(value, Path) else "",
)
def test_code_of_a_page_runs_as_written(folder: Path, page: Path, files: list[str]) -> None:
    run_page(page)
    assert [name for name in files if not (folder / name).stat().st_size] == []


def test_lines_that_are_not_run_are_in_the_pages() -> None:
    lines = {
        shlex.join(shlex.split(c.text, comments=True))
        for p in (README, TUTORIAL, PYTHON)
        for c in code_of(p)
        if not c.language
    }
    assert {shlex.join(shlex.split(line)) for line in NOT_RUN} <= lines


def test_a_line_that_fails_is_seen(folder: Path) -> None:
    with pytest.raises(AssertionError):
        run_line("trackslip replay out/no_such_bag")
