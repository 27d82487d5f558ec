# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Machine code on disk: found again by another process, and never older than its sources."""

import os
import subprocess
import sys
from pathlib import Path

CALLEE = """
from trackslip_common.compiled import compiled

@compiled
def inner(x: float) -> float:
    return x + {added}
"""
CALLER = """
from inner import inner
from trackslip_common.compiled import compiled

@compiled
def outer(x: float) -> float:
    return 10.0 * inner(x)

print(outer(1.0), sum(outer.stats.cache_hits.values()))
"""


def run(folder: Path) -> list[float]:
    """What the caller prints: its result, and how many of its compilations it found on disk."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    environment["NUMBA_CACHE_DIR"] = str(folder / "cache")
    done = subprocess.run(
        [sys.executable, "outer.py"], cwd=folder, env=environment, capture_output=True, text=True, check=True
    )
    return [float(word) for word in done.stdout.split()]


def test_a_kernel_is_compiled_once_and_again_when_what_it_calls_changes(tmp_path: Path) -> None:
    (tmp_path / "outer.py").write_text(CALLER, encoding="utf-8")
    (tmp_path / "inner.py").write_text(CALLEE.format(added=1.0), encoding="utf-8")
    assert run(tmp_path) == [20.0, 0.0]
    assert run(tmp_path) == [20.0, 1.0]
    (tmp_path / "inner.py").write_text(CALLEE.format(added=2.0), encoding="utf-8")
    assert run(tmp_path) == [30.0, 0.0]


def test_a_kernel_that_calls_another_folder_is_compiled_again_when_that_changes(tmp_path: Path) -> None:
    (tmp_path / "trackslip_below").mkdir()
    inner = tmp_path / "trackslip_below" / "inner.py"
    caller = CALLER.replace("from inner import", "from trackslip_below.inner import")
    (tmp_path / "outer.py").write_text(caller, encoding="utf-8")
    inner.write_text(CALLEE.format(added=1.0), encoding="utf-8")
    assert run(tmp_path) == [20.0, 0.0]
    assert run(tmp_path) == [20.0, 1.0]
    inner.write_text(CALLEE.format(added=2.0), encoding="utf-8")
    assert run(tmp_path) == [30.0, 0.0]


def test_a_module_with_two_names_loads_machine_code_of_its_own(tmp_path: Path) -> None:
    """``make test`` and ``colcon test`` import a file of tests by two names, and share what is on disk."""
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "inner.py").write_text(CALLEE.format(added=1.0), encoding="utf-8")
    ask = "from {name} import inner\nprint(inner(1.0), sum(inner.stats.cache_hits.values()))\n"
    by_folder = "import sys\nsys.path.append('below')\n" + ask.format(name="inner")
    for text, found in ((by_folder, 0.0), (ask.format(name="below.inner"), 0.0), (by_folder, 1.0)):
        (tmp_path / "outer.py").write_text(text, encoding="utf-8")
        assert run(tmp_path) == [2.0, found]


def test_a_folder_and_a_link_to_it_share_machine_code(tmp_path: Path) -> None:
    """After ``setup.bash`` modules come through colcon's links: all was compiled once more, for minutes."""
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "inner.py").write_text(CALLEE.format(added=1.0), encoding="utf-8")
    (tmp_path / "below" / "trackslip_caller.py").write_text(CALLER, encoding="utf-8")
    (tmp_path / "link").symlink_to("below")
    for folder, found in (("below", 0.0), ("link", 1.0)):
        text = f"import sys\nsys.path.append('{folder}')\nimport trackslip_caller\n"
        (tmp_path / "outer.py").write_text(text, encoding="utf-8")
        assert run(tmp_path) == [20.0, found]
