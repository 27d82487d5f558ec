# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The notebooks of docs/ run from top to bottom, and are stored without output."""

import json
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "docs/notebooks").glob("*.ipynb"))
each = pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)


def test_there_are_notebooks() -> None:
    assert {path.stem for path in NOTEBOOKS} == {"demo", "own_log", "ground", "robot_localization"}


@each
def test_notebook_is_stored_without_output(notebook: Path) -> None:
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert code
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)


@pytest.mark.slow
@each
def test_notebook_runs(notebook: Path, tmp_path: Path) -> None:
    pytest.importorskip("ipykernel", reason="pip install -r requirements/notebooks.txt")
    pytest.importorskip("pandas", reason="pip install -r requirements/notebooks.txt")
    nbclient = pytest.importorskip("nbclient", reason="pip install -r requirements/notebooks.txt")
    nbformat = pytest.importorskip("nbformat")
    book = nbformat.read(notebook, as_version=4)
    resources = {"metadata": {"path": str(tmp_path)}}  # folder of its files
    nbclient.NotebookClient(book, timeout=600, resources=resources).execute()
