# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled code on disk: loaded by another process, and never older than its sources."""

import os
import queue
import shutil
import subprocess
import sys
import threading
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numba
import pytest
from numba.core import event

from trackslip_common import compiling, machine_code
from trackslip_common.compiling import DESK_TEXT, announce_compilation, report_compilation
from trackslip_common.errors import collect_output

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
CONSTANTS = """
from trackslip_common.compiled import compiled

@compiled
def multiple(x: float, times: int) -> float:
    return x if times == 1 else x * times

@compiled
def sum_of_multiples(x: float, n: int) -> float:
    return multiple(x, 1) + multiple(x, 2) + multiple(x, n)

print(sum_of_multiples(2.0, 3), len(multiple.overloads))
"""


def run(folder: Path) -> list[float]:
    """The numbers that ``outer.py`` prints, with its own cache of compiled code."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    environment["NUMBA_CACHE_DIR"] = str(folder / "cache")
    done = subprocess.run(
        [sys.executable, "outer.py"], cwd=folder, env=environment, capture_output=True, text=True, check=True
    )
    return [float(word) for word in done.stdout.split()]


@pytest.mark.parametrize("package", ["", pytest.param("trackslip_below", marks=pytest.mark.slow)])
def test_a_kernel_is_compiled_once_and_again_when_what_it_calls_changes(tmp_path: Path, package: str) -> None:
    """The callee is in the same folder or in another."""
    inner = tmp_path / package / "inner.py"
    inner.parent.mkdir(exist_ok=True)
    caller = CALLER.replace("from inner", f"from {package}.inner" if package else "from inner")
    (tmp_path / "outer.py").write_text(caller, encoding="utf-8")
    inner.write_text(CALLEE.format(added=1.0), encoding="utf-8")
    assert run(tmp_path) == [20.0, 0.0]
    assert run(tmp_path) == [20.0, 1.0]
    inner.write_text(CALLEE.format(added=2.0), encoding="utf-8")
    assert run(tmp_path) == [30.0, 0.0]


def test_kernel_is_compiled_once_for_all_constants_of_its_callers(tmp_path: Path) -> None:
    (tmp_path / "outer.py").write_text(CONSTANTS, encoding="utf-8")
    assert run(tmp_path) == [12.0, 1.0]


@pytest.mark.slow
def test_a_module_with_two_names_loads_machine_code_of_its_own(tmp_path: Path) -> None:
    """``make test`` and ``colcon test`` import a test file by two names and share the cache on disk."""
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "inner.py").write_text(CALLEE.format(added=1.0), encoding="utf-8")
    program = "from {name} import inner\nprint(inner(1.0), sum(inner.stats.cache_hits.values()))\n"
    by_folder = "import sys\nsys.path.append('below')\n" + program.format(name="inner")
    for text, cache_hits in ((by_folder, 0.0), (program.format(name="below.inner"), 0.0), (by_folder, 1.0)):
        (tmp_path / "outer.py").write_text(text, encoding="utf-8")
        assert run(tmp_path) == [2.0, cache_hits]


@pytest.mark.slow
def test_folder_and_link_to_it_share_machine_code(tmp_path: Path) -> None:
    """After ``setup.bash`` modules are imported through links of colcon."""
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "inner.py").write_text(CALLEE.format(added=1.0), encoding="utf-8")
    (tmp_path / "below" / "trackslip_caller.py").write_text(CALLER, encoding="utf-8")
    (tmp_path / "link").symlink_to("below")
    for folder, cache_hits in (("below", 0.0), ("link", 1.0)):
        text = f"import sys\nsys.path.append('{folder}')\nimport trackslip_caller\n"
        (tmp_path / "outer.py").write_text(text, encoding="utf-8")
        assert run(tmp_path) == [20.0, cache_hits]


SHIPPED = """
from pathlib import Path
from trackslip_common import machine_code
machine_code.SHIPPED = Path("shipped")
"""


def write_kernel(folder: Path) -> None:
    """Write a kernel in its own folder; its program prints the result and the number of cache hits."""
    folder.mkdir()
    (folder / "kernel.py").write_text(CALLEE.format(added=1.0), encoding="utf-8")
    text = f"{SHIPPED}\nfrom kernel import inner\nprint(inner(1.0), sum(inner.stats.cache_hits.values()))\n"
    (folder / "outer.py").write_text(text, encoding="utf-8")


def test_shipped_machine_code_for_any_processor_is_used_at_another_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built, used = tmp_path / "made", tmp_path / "used"
    write_kernel(built)
    write_kernel(used)
    with monkeypatch.context() as context:
        context.setenv("NUMBA_CPU_NAME", "generic")
        assert run(built) == [2.0, 0.0]
    shutil.copytree(built / "cache", used / "shipped")
    assert run(used) == [2.0, 1.0]
    assert not (used / "cache").exists()  # nothing was compiled


def test_machine_code_is_kept_with_the_user_where_sources_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert machine_code.cache_directory(str(tmp_path / "kernel.py")) == tmp_path / "trackslip"


def test_compilation_is_announced_at_once_while_output_is_collected(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with announce_compilation(), collect_output() as lines:
        numba.njit(lambda x: x + 1.0)(1.0)
        assert capsys.readouterr().err == f"{DESK_TEXT}\n"
    assert lines == []


def test_terminal_shows_the_remaining_compile_time_and_clears_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    shown = queue.Queue[str]()
    with announce_compilation(shown.put):
        with event.trigger_event("numba:compile"):
            assert shown.get(timeout=30.0).startswith("compiling, about 120 s left")
        assert shown.get(timeout=30.0) == ""
    assert shown.empty()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("elapsed", "used", "text"),
    [(30.0, 30.0, "about 30 s left"), (70.0, 30.0, "about 60 s left"), (100.0, 70.0, "almost done")],
)
def test_remaining_compile_time_grows_with_processor_load(
    monkeypatch: pytest.MonkeyPatch, elapsed: float, used: float, text: str
) -> None:
    begun, times = threading.Event(), {"monotonic": 7.0, "process_time": 3.0}
    clock = SimpleNamespace(**{name: partial(times.__getitem__, name) for name in times})
    monkeypatch.setattr(compiling, "time", clock)
    monkeypatch.setattr(compiling, "_PERIOD", 0.01)
    shown = queue.Queue[str]()

    def report(line: str) -> None:
        begun.set()
        shown.put(line)

    with report_compilation(lambda _: None, report), event.trigger_event("numba:compile"):
        assert begun.wait(30.0)
        times["monotonic"] += elapsed
        times["process_time"] += used
        while text not in shown.get(timeout=30.0):
            pass
