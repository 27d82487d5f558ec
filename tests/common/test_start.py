# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C at moments at which Python would lose it."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from fixtures.patience import PATIENCE

from trackslip_common.errors import ExitCode

LOSING = {
    "a_callback": """
import ctypes
CALLBACK = ctypes.CFUNCTYPE(None)
@CALLBACK
def callback():
    print("here", flush=True)
    time.sleep(600.0)
callback()
""",
    "the_end_of_an_object": """
class Object:
    def __del__(self):
        print("here", flush=True)
        time.sleep(600.0)
made = Object()
del made
""",
    "code_that_a_string_holds": """
exec("print('here', flush=True); time.sleep(600.0)")
""",
}
LATE = """
import ctypes, sys
from trackslip_common.start import repeat_lost_interrupts
repeat_lost_interrupts()
libc = ctypes.CDLL(None)
libc.on_exit(libc.sleep, None)  # for as many seconds as the exit code has: some middleware takes as long
class Object:
    def __del__(self):
        raise KeyboardInterrupt
made = Object()
del made
sys.exit(1)
"""
HANGING = """
import ctypes, sys, types
from trackslip_common.start import start
libc = ctypes.CDLL(None)
libc.on_exit(libc.pause, None)
sys.modules["program"] = types.SimpleNamespace(main=int)
start("program")
"""
PROGRAM = """
import sys, time
from trackslip_common.start import repeat_lost_interrupts
repeat_lost_interrupts()
try:
{body}
    time.sleep(600.0)
except KeyboardInterrupt:
    sys.exit(130)
"""


def test_missing_library_is_named_in_one_line() -> None:
    code = "import sys; sys.modules['cantools'] = None; from trackslip_drivers import executables as e"
    command = [sys.executable, "-c", f"{code}; e.can_driver()"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == ExitCode.BAD_INPUT
    (line,) = done.stderr.splitlines()
    assert line.startswith("can_driver: ")
    assert "cantools" in line


@pytest.mark.parametrize("place", LOSING)
def test_ctrl_c_ends_the_program_where_python_ignores_it(place: str, tmp_path: Path) -> None:
    """Exit code 130 and no traceback; a lost interrupt is repeated."""
    body = "\n".join(f"    {line}" for line in LOSING[place].splitlines())
    (tmp_path / "program.py").write_text(PROGRAM.format(body=body))
    command, output = [sys.executable, "-m", "program"], subprocess.PIPE
    with subprocess.Popen(command, stdout=output, stderr=output, text=True, cwd=tmp_path) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline() == "here\n"
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 130
        assert process.stderr.read() == ""


def test_ctrl_c_lost_at_exit_keeps_the_exit_code() -> None:
    """The alarm that repeats a lost interrupt must not kill a process that is already exiting."""
    done = subprocess.run([sys.executable, "-c", LATE], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (1, "")


@pytest.mark.parametrize(
    ("main", "code"),
    [("lambda: 3", 3), ("lambda: sys.exit(4)", 4), ("lambda: sys.exit('refused')", 1), ("lambda: 1 / 0", 1)],
)
def test_program_whose_middleware_hangs_at_exit_ends_with_its_own_code(main: str, code: int) -> None:
    """Exit handlers of libraries that never return are not called."""
    done = subprocess.run(
        [sys.executable, "-c", HANGING.replace("int", main)],
        capture_output=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == code
    assert (b"refused" in done.stderr) == ("refused" in main)
    assert (b"ZeroDivisionError" in done.stderr) == ("/" in main)
