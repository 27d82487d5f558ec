# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""How set-up runs commands, reports progress and remembers how far it came."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "src" / "trackslip_common"))  # nothing is installed yet

from trackslip_common.whole_file import replacing  # noqa: E402 (found there)

LOG = ROOT / "ros2_ws" / "setup.log"
_POLL = 0.05  # s
_asked: list[int] = []  # signals that came


class SetupError(Exception):
    """Set-up cannot go on; the message is one line that says what to do."""


class Step:
    """Reports on the terminal what is going on, and how long it took."""

    def __init__(self, what: str) -> None:
        self.what = what

    def __enter__(self) -> None:
        self.started = time.monotonic()
        print(f"setup: {self.what} ...", flush=True)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            print(f"setup: {self.what}: {time.monotonic() - self.started:.0f} s", flush=True)


def note_interrupts() -> None:
    """Has Ctrl-C and SIGTERM raised only where set-up waits; a command just being started could get lost."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: _asked.append(number))


def check_interrupts() -> None:
    """Raises KeyboardInterrupt where the user has asked for the end."""
    if _asked:
        raise KeyboardInterrupt


class Command(NamedTuple):
    """What to run, in which environment (None: this process's), where, and with which niceness."""

    arguments: list[str]
    environment: dict[str, str] | None = None
    directory: Path = ROOT
    niceness: int = 0


class Job:
    """A command that runs beside others, with its output in the log, and all that it starts in a group."""

    def __init__(self, command: Command) -> None:
        check_interrupts()
        self.command = command
        self.began = LOG.stat().st_size
        asks_here = command.arguments[0] == "sudo"  # for a password, at this terminal
        with LOG.open("a") as log:
            log.write(f"$ {' '.join(command.arguments)}\n")
            log.flush()
            self.process = subprocess.Popen(
                command.arguments,
                env=command.environment,
                cwd=command.directory,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=not asks_here,
            )
        if command.niceness:
            os.setpriority(os.PRIO_PROCESS, self.process.pid, command.niceness)  # what it starts inherits it

    def is_running(self) -> bool:
        """Whether it is at work still.

        Raises:
            SetupError: it failed; the end of the output since its start has been shown.
            KeyboardInterrupt: the user has asked for the end.
        """
        check_interrupts()
        if self.process.poll():
            output = LOG.read_bytes()[self.began :].decode(errors="replace").splitlines()
            print("\n".join(output[-25:]), file=sys.stderr)
            command = " ".join(self.command.arguments[:4])
            raise SetupError(f"'{command} ...' failed; the whole output is in {LOG}")
        return self.process.returncode is None

    def stop(self) -> None:
        """Ends what still runs of it."""
        if self.process.poll() is not None:
            return
        if self.command.arguments[0] == "sudo":
            self.process.terminate()
        else:
            os.killpg(self.process.pid, signal.SIGTERM)
        self.process.wait()


def run(command: Command) -> None:
    """Runs one command to its end, or until the user interrupts; raises as ``Job.is_running`` does."""
    with beside([command]):
        pass


@contextmanager
def beside(commands: list[Command]) -> Iterator[None]:
    """Runs commands beside the block and waits for them after it; where anything fails, ends them all."""
    jobs: list[Job] = []
    try:
        for command in commands:
            jobs.append(Job(command))
        yield
        while [job for job in jobs if job.is_running()]:  # each is looked at
            time.sleep(_POLL)
    finally:
        for job in jobs:
            job.stop()


def succeeds(command: list[str]) -> bool:
    """Whether the command ends with success; its output goes nowhere."""
    return subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True).returncode == 0


def read_stamp(stamp: Path) -> dict[str, str]:
    """What a stamp holds; nothing where set-up never came that far, or where the file is damaged."""
    try:
        found = json.loads(stamp.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def write_stamp(stamp: Path, digest: str, ros: str) -> None:
    """Records that a part of the set-up is complete; without a digest, that it has begun."""
    write_file(stamp, json.dumps({"digest": digest, "ros": ros}))


def write_file(path: Path, text: str, mode: int = 0o644) -> None:
    """Writes a file whole or not at all: whoever reads meanwhile finds the old one or the new one."""
    with replacing(path, text, mode, sync=True):
        pass
