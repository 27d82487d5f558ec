# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A motion model describes its states; a new one needs its own file and its lines in the dispatch only."""

import ast
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from fixtures import toy_model
from fixtures.patience import PATIENCE

from trackslip_estimation.slip.models import dispatch
from trackslip_estimation.slip.models.model import FIX_DELAY, GYRO_SCALE, SIZE

SOURCES = Path(__file__).resolve().parents[3] / "src"
MODELS = (*dispatch.MODELS.values(), toy_model)


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__.split(".")[-1])
def test_the_named_parts_cover_the_state_once_each_number_with_its_unit(model: ModuleType) -> None:
    numbers = [k for part in model.PARTS for k in range(SIZE)[part.at]]
    of_all = {GYRO_SCALE, FIX_DELAY}  # constant 0 in the thesis' model
    assert sorted(numbers) == sorted({*range(model.ACTIVE)} | of_all)
    assert len({part.name for part in model.PARTS}) == len(model.PARTS)
    for part in model.PARTS:
        units = [unit.strip() for unit in part.unit.split(",")]
        assert len(units) == len(range(SIZE)[part.at])
        assert all(units)
        assert part.meaning


def test_models_have_codes_and_names_of_their_own() -> None:
    assert len({model.CODE for model in dispatch.MODELS.values()}) == len(dispatch.MODELS)
    assert all(name == model.NAME for name, model in dispatch.MODELS.items())


def test_new_model_needs_one_file() -> None:
    """The model replaces another in the dispatch; all else follows from its description."""
    path = os.pathsep.join((str(Path(toy_model.__file__).parents[1]), *filter(None, sys.path)))
    done = subprocess.run(
        [sys.executable, "-m", "fixtures.toy_model_drive"],
        env=os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("drove")


def test_only_the_dispatch_calls_a_model() -> None:
    """Other modules import only constants and records of a model; one place selects its functions."""
    models = {model.__name__ for model in dispatch.MODELS.values()}
    wrong = {}
    files = [file for file in SOURCES.glob("*/*/**/*.py") if file.parts[-2:] != ("models", "dispatch.py")]
    assert len(files) > 400
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.ImportFrom) or node.level:
                continue
            named = {alias.name for alias in node.names}
            if node.module in models:
                wrong |= {(file.name, name): node.module for name in named if not name[0].isupper()}
            whole = {f"{node.module}.{name}" for name in named} & models
            wrong |= {(file.name, name): "as a whole" for name in whole}
    assert wrong == {}
