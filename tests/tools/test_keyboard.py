# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Keys are read one by one on a terminal, which is restored at the end; a pipe is not read."""

import io
import os
import pty
import sys
from contextlib import suppress

import pytest

from trackslip_tools.cli.publish import Keyboard

CHILD = """
import sys, termios, time
sys.path[:] = {path!r}
from trackslip_tools.cli.publish import Keyboard
before = termios.tcgetattr(0)
text = ""
with Keyboard() as keyboard:
    assert keyboard.read_keys() == ""
    print("ready", flush=True)
    while not text.endswith("q"):
        text += keyboard.read_keys()
        time.sleep(0.01)
print("typed", repr(text), termios.tcgetattr(0) == before, flush=True)
"""


def read_until(terminal: int, word: bytes) -> bytes:
    """Output of the child up to this word or its end."""
    received = b""
    with suppress(OSError):  # the child has ended
        while word not in received:
            received += os.read(terminal, 1000)
    return received


def test_keys_act_without_enter_and_the_terminal_is_restored() -> None:
    pid, terminal = pty.fork()
    if pid == 0:
        os.execv(sys.executable, [sys.executable, "-c", CHILD.format(path=sys.path)])
    received = read_until(terminal, b"ready")
    assert received.strip() == b"ready"  # the line end may arrive later
    os.write(terminal, b"  x")
    os.write(terminal, b"q")
    assert b"typed '  xq' True" in read_until(terminal, b"True")
    assert os.waitpid(pid, 0)[1] == 0
    os.close(terminal)


def test_pipe_gives_no_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("   "))
    with Keyboard() as keyboard:
        assert keyboard.read_keys() == ""
