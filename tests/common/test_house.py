# SPDX-License-Identifier: Apache-2.0
"""What travels together is one argument: no function of ours takes more than six."""

import ast
from pathlib import Path

import pytest

ESTIMATION = Path(__file__).resolve().parents[2] / "src/trackslip_estimation/trackslip_estimation"


@pytest.mark.parametrize("room", ["kalman", "slip", "soil", "box", "terramechanics"])
def test_no_function_takes_more_than_six_arguments(room: str) -> None:
    files = sorted((ESTIMATION / room).rglob("*.py"))
    assert files
    found = {}
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
                found[f"{file.name}:{node.name}"] = len([n for n in names if n not in ("self", "cls")])
    assert {name: count for name, count in found.items() if count > 6} == {}
    assert max(found.values()) > 1


def test_predict_gate_and_update_stand_once() -> None:
    """Only ``slip/step.py`` propagates a state, and only its ``update.py`` corrects it."""
    callers = set()
    for file in ESTIMATION.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            called = (
                node.func.attr if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) else ""
            )
            if called in ("propagate_covariance", "correct"):
                callers.add(file.name)
    assert callers == {"step.py", "update.py"}
