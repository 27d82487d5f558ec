# SPDX-License-Identifier: Apache-2.0
"""How set-up runs commands and talks: a line per step on the terminal, all output in a log."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LOG = ROOT / "ros2_ws" / "setup.log"


class SetupError(Exception):
    """Set-up cannot go on; the message is one line that says what to do."""


class Step:
    """Says on the terminal what is going on, and how long it took."""

    def __init__(self, what: str) -> None:
        self.what = what

    def __enter__(self) -> None:
        self.started = time.monotonic()
        print(f"setup: {self.what} ...", flush=True)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            print(f"setup: {self.what}: {time.monotonic() - self.started:.0f} s", flush=True)


def run(command: list[str], environment: dict[str, str] | None = None, directory: Path = ROOT) -> None:
    """Runs a command with its output in the log.

    Raises:
        SetupError: it failed; the end of its output has been shown.
    """
    begin = LOG.stat().st_size
    with LOG.open("a") as log:
        log.write(f"$ {' '.join(command)}\n")
        log.flush()
        status = subprocess.run(
            command, env=environment, cwd=directory, stdin=subprocess.DEVNULL, stdout=log, stderr=log
        ).returncode
    if status:
        output = LOG.read_bytes()[begin:].decode(errors="replace").splitlines()
        print("\n".join(output[-25:]), file=sys.stderr)
        raise SetupError(f"'{' '.join(command[:4])} ...' failed; the whole output is in {LOG}")


def succeeds(command: list[str]) -> bool:
    """Whether the command ends with success; its output goes nowhere."""
    return subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True).returncode == 0
