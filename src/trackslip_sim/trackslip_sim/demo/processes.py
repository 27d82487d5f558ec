# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Starts each node in its own process, and ends all of them in any case."""

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import yaml

from trackslip_common.errors import InputError
from trackslip_sim.demo.graph import NodeSpec

_PR_SET_PDEATHSIG = 1
_KILL_DELAY = 10.0  # s from SIGINT to SIGKILL: a killed recorder leaves an incomplete bag
_SIGINT_PERIOD = 2.0  # s between repeated SIGINTs
_POLL_PERIOD = 0.02  # s


class DemoFailure(RuntimeError):
    """A failure that ends the demo; its text is shown to the user."""


@contextmanager
def deferred_interrupts() -> Iterator[Callable[[], None]]:
    """Defer Ctrl-C: the yielded function raises it when called, else the exit raises it.

    An immediate KeyboardInterrupt could be lost in a fork or interrupt the executor.
    """
    interrupts: list[int] = []

    def check() -> None:
        if interrupts:
            raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, lambda number, _: interrupts.append(number))
    try:
        yield check
    finally:
        signal.signal(signal.SIGINT, before)
    check()


class Processes:
    """Child processes; the output of each goes to its own log."""

    def __init__(self, logs: Path, environment: Mapping[str, str]) -> None:
        self._logs = logs
        self._environment = dict(environment)
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._needed: set[str] = set()

    def start(self, node: NodeSpec) -> None:
        """Run one node.

        Raises:
            InputError: its executable is not installed.
        """
        arguments = [str(executable(node.package, node.executable)), "--ros-args"]
        for name, value in node.parameters.items():
            arguments += ["-p", f"{name}:={yaml.safe_dump(value, default_flow_style=True).splitlines()[0]}"]
        self.run(node.executable, arguments, is_needed=node.is_needed)

    def run(self, name: str, arguments: Sequence[str], *, is_needed: bool = True) -> None:
        """Run a program under a name."""
        if is_needed:
            self._needed.add(name)
        with (self._logs / f"{name}.log").open("wb") as log, deferred_interrupts():
            self._running[name] = subprocess.Popen(
                arguments,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=self._environment,
                start_new_session=True,  # Ctrl-C reaches only the demo, which ends the others in order
                preexec_fn=_end_with_parent,
            )

    def pids(self) -> dict[str, int]:
        """Process ids by name."""
        return {name: process.pid for name, process in self._running.items()}

    def log(self, name: str) -> str:
        """Content of a node's log."""
        return (self._logs / f"{name}.log").read_text(encoding="utf-8", errors="replace").strip()

    def exit_codes(self) -> dict[str, int]:
        """Exit codes of the needed nodes that have ended."""
        codes = {name: self._running[name].poll() for name in self._needed & self._running.keys()}
        return {name: code for name, code in codes.items() if code is not None}

    @deferred_interrupts()
    def stop(self, names: Iterable[str] | None = None) -> None:
        """Interrupt these nodes (or all); kill them after ``_KILL_DELAY``; Ctrl-C is deferred."""
        chosen = {
            name: self._running.pop(name) for name in list(names or self._running) if name in self._running
        }
        deadline, next_signal = time.monotonic() + _KILL_DELAY, 0.0
        while (left := _running_processes(chosen)) and (now := time.monotonic()) < deadline:
            if now >= next_signal:  # repeated: a signal may be lost while Python starts
                for process in left.values():
                    _signal(process, signal.SIGINT)
                next_signal = now + _SIGINT_PERIOD
            time.sleep(_POLL_PERIOD)
        killed = _running_processes(chosen)
        for name in killed:
            _signal(chosen[name], signal.SIGKILL)
        for process in chosen.values():
            process.wait()
        for name in killed:
            text = f"{name} did not end within {_KILL_DELAY:g} s of being asked, and was killed"
            print(text, file=sys.stderr)


def executable(package: str, name: str) -> Path:
    """Path of a package's installed executable.

    Raises:
        InputError: it is not on AMENT_PREFIX_PATH.
    """
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        path = Path(prefix) / "lib" / package / name
        if path.is_file():
            return path
    raise InputError(f"executable '{name}' of {package} not found on AMENT_PREFIX_PATH; run make setup")


def _running_processes(
    processes: Mapping[str, "subprocess.Popen[bytes]"],
) -> dict[str, "subprocess.Popen[bytes]"]:
    return {name: process for name, process in processes.items() if process.poll() is None}


def _signal(process: "subprocess.Popen[bytes]", number: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, number)


def _end_with_parent() -> None:
    """In the child: request SIGINT when the parent dies; handle Ctrl-C even if the shell disabled it."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGINT)
    signal.signal(signal.SIGINT, signal.default_int_handler)
