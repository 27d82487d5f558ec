# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Reports that kernels are being compiled, once after an installation, and about how long it still takes."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

TEXT = "compiling, about a minute: once after an installation"
DESK_TEXT = "compiling for this processor, once after an installation: about two minutes"
NODE_S, DESK_S = 60.0, 120.0  # of a processor, that what a node or a replay needs is in compiling
_PERIOD, _STEP = 1.0, 5.0  # s
_LEAST_USED_S = 10.0  # s, of a free processor, before what others take of it counts
_CLEAR = "\r\x1b[2K"  # the line of a terminal


def show_in_place(text: str) -> None:
    """On the line of the cursor of a terminal."""
    print(f"{_CLEAR}{text}", end="", file=sys.stderr, flush=True)


@contextmanager
def compilation_announced(show: Callable[[str], None] = show_in_place) -> Iterator[None]:
    """What is done inside compiles: a countdown on a terminal, elsewhere one line on stderr.

    ``show`` puts the countdown in place, and takes it away for an empty text. The one line comes at once,
    though other lines are collected.
    """
    is_terminal = sys.stderr.isatty()
    log, report = (_ignore, show) if is_terminal else (_print_desk_text, _ignore)
    with compilation_reported(log, report, DESK_S):
        yield


@contextmanager
def compilation_reported(
    log: Callable[[str], None], report: Callable[[str], None], expected_s: float = NODE_S
) -> Iterator[None]:
    """Where what is done inside compiles, ``log`` gets one line, and ``report`` a countdown once a second.

    Kernels that are on the disk are only loaded: then nothing is reported. ``report`` is called by a thread;
    it gets an empty text where a kernel is done.
    """
    if "numba" not in sys.modules:  # a node without kernels
        yield
        return
    from numba.core import event  # not loaded for others

    countdown = _Countdown(log, report, expected_s)

    class Listener(event.Listener):  # type: ignore[misc]  # numba has no types
        def on_start(self, _: Any) -> None:
            countdown.begin()

        def on_end(self, _: Any) -> None:
            countdown.end()

    try:
        with event.install_listener("numba:compile", Listener()):
            yield
    finally:
        countdown.stop()


class _Countdown:
    """By the processor time that compilation has taken, for other programs may hold it up."""

    def __init__(self, log: Callable[[str], None], report: Callable[[str], None], expected_s: float) -> None:
        self._log, self._report, self._expected_s = log, report, expected_s
        self._depth = 0  # of kernels that are compiled as parts of others
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="compiling", daemon=True)

    def begin(self) -> None:
        """A kernel begins."""
        self._depth += 1
        if self._thread.ident is None:
            self._begun = time.monotonic(), time.process_time()
            self._log(TEXT)
            self._thread.start()

    def end(self) -> None:
        """A kernel ends; another may follow."""
        self._depth -= 1

    def stop(self) -> None:
        """Nothing is compiled any more."""
        self._stopped.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        shown = ""
        while not self._stopped.is_set():
            text = self._text() if self._depth else ""
            if text or shown:
                self._report(text)
            shown = text
            self._stopped.wait(_PERIOD)
        if shown:
            self._report("")

    def _text(self) -> str:
        elapsed, used = time.monotonic() - self._begun[0], time.process_time() - self._begun[1]
        left = (self._expected_s - used) * max((elapsed + _LEAST_USED_S) / (used + _LEAST_USED_S), 1.0)
        if left < _STEP:
            return "compiling, almost done"
        return f"compiling, about {_STEP * round(left / _STEP):.0f} s left"


def _ignore(_: str) -> None:
    """For where nothing is shown."""


def _print_desk_text(_: str) -> None:
    print(DESK_TEXT, file=sys.stderr, flush=True)
