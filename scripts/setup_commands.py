# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Runs the commands of set-up, reports progress, and stores completed parts."""

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
sys.path.insert(0, str(ROOT / "src" / "trackslip_common"))  # packages are not installed yet

from trackslip_common.atomic_files import atomic_replacement  # noqa: E402 (found there)

LOG = ROOT / "ros2_ws" / "setup.log"
_POLL = 0.05  # s
_received_signals: list[int] = []  # received signals


class SetupError(Exception):
    """An error that ends set-up; its message is one line with the remedy."""


class Step:
    """Reports a step and its duration on the terminal."""

    def __init__(self, what: str) -> None:
        self.what = what

    def __enter__(self) -> None:
        self.started = time.monotonic()
        print(f"setup: {self.what} ...", flush=True)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            print(f"setup: {self.what}: {time.monotonic() - self.started:.0f} s", flush=True)


def note_interrupts() -> None:
    """Defer Ctrl-C and SIGTERM until set-up waits; a command being started could be lost otherwise."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: _received_signals.append(number))


def check_interrupts() -> None:
    """Raise KeyboardInterrupt after a deferred signal."""
    if _received_signals:
        raise KeyboardInterrupt


class Command(NamedTuple):
    """A command with environment (None: this process's), directory and niceness."""

    arguments: list[str]
    environment: dict[str, str] | None = None
    directory: Path = ROOT
    niceness: int = 0


class Job:
    """A command that runs in parallel, in its own process group, with its output in the log."""

    def __init__(self, command: Command) -> None:
        check_interrupts()
        self.command = command
        self.began = LOG.stat().st_size
        asks_here = command.arguments[0] == "sudo"  # sudo asks for a password at this terminal
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
            os.setpriority(os.PRIO_PROCESS, self.process.pid, command.niceness)  # inherited by its children

    def is_running(self) -> bool:
        """Whether the command is still running.

        Raises:
            SetupError: the command failed; the end of its output has been shown.
            KeyboardInterrupt: a signal was received.
        """
        check_interrupts()
        if self.process.poll():
            output = LOG.read_bytes()[self.began :].decode(errors="replace").splitlines()
            print("\n".join(output[-25:]), file=sys.stderr)
            command = " ".join(self.command.arguments[:4])
            raise SetupError(f"'{command} ...' failed; the whole output is in {LOG}")
        return self.process.returncode is None

    def stop(self) -> None:
        """End the command and its children."""
        if self.process.poll() is not None:
            return
        if self.command.arguments[0] == "sudo":
            self.process.terminate()
        else:
            os.killpg(self.process.pid, signal.SIGTERM)
        self.process.wait()


def run(command: Command) -> None:
    """Run one command to its end or to an interrupt; raises as ``Job.is_running``."""
    with in_parallel([command]):
        pass


@contextmanager
def in_parallel(commands: list[Command]) -> Iterator[None]:
    """Run commands in parallel to the block and wait for them after it; after a failure, end all."""
    jobs: list[Job] = []
    try:
        for command in commands:
            jobs.append(Job(command))
        yield
        while [job for job in jobs if job.is_running()]:  # checks each job
            time.sleep(_POLL)
    finally:
        for job in jobs:
            job.stop()


def succeeds(command: list[str]) -> bool:
    """Whether a command succeeds; its output is discarded."""
    return subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True).returncode == 0


def read_stamp(stamp: Path) -> dict[str, str]:
    """Content of a stamp; empty if the file is missing or damaged."""
    try:
        content = json.loads(stamp.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def write_stamp(stamp: Path, digest: str, ros: str) -> None:
    """Record that a part of the set-up is complete; without a digest, that it has begun."""
    write_file(stamp, json.dumps({"digest": digest, "ros": ros}))


def write_file(path: Path, text: str, mode: int = 0o644) -> None:
    """Write a file atomically: readers find the old or the new content."""
    with atomic_replacement(path, text, mode, sync=True):
        pass
