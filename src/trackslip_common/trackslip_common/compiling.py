# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Reports that kernels are being compiled, once after an installation, and estimates the time left."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

TEXT = "compiling, about a minute: once after an installation"
DESK_TEXT = "compiling for this processor, once after an installation: about two minutes"
NODE_S, DESK_S = 60.0, 120.0  # processor time to compile the kernels of a node, of a replay
_PERIOD, _STEP = 1.0, 5.0  # s
_TIME_OFFSET_S = 10.0  # s, added to both times: the load by others counts little at first
_CLEAR_LINE = "\r\x1b[2K"  # clears the line of a terminal


def show_in_place(text: str) -> None:
    """Show a text in place of the terminal's present line."""
    print(f"{_CLEAR_LINE}{text}", end="", file=sys.stderr, flush=True)


@contextmanager
def announce_compilation(show: Callable[[str], None] = show_in_place) -> Iterator[None]:
    """Announce compilations inside the block: a countdown on a terminal, else one line on stderr.

    ``show`` shows the countdown in place, and removes it for an empty text. The one line is printed at once,
    even while other lines are collected.
    """
    is_terminal = sys.stderr.isatty()
    log, report = (_ignore, show) if is_terminal else (_print_desk_text, _ignore)
    with report_compilation(log, report, DESK_S):
        yield


@contextmanager
def report_compilation(
    log: Callable[[str], None], report: Callable[[str], None], expected_s: float = NODE_S
) -> Iterator[None]:
    """If code in the block compiles, ``log`` gets one line, and ``report`` a countdown once a second.

    Kernels that are only loaded from disk are not reported. A thread calls ``report``; the text is empty at
    the end of a kernel.
    """
    if "numba" not in sys.modules:  # a node without kernels
        yield
        return
    from numba.core import event  # loaded only with kernels

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
    """Countdown by the processor time of the compilation, as other programs may delay it."""

    def __init__(self, log: Callable[[str], None], report: Callable[[str], None], expected_s: float) -> None:
        self._log, self._report, self._expected_s = log, report, expected_s
        self._depth = 0  # nested compilations of kernels
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="compiling", daemon=True)

    def begin(self) -> None:
        """Register the begin of a kernel's compilation."""
        self._depth += 1
        if self._thread.ident is None:
            self._begun = time.monotonic(), time.process_time()
            self._log(TEXT)
            self._thread.start()

    def end(self) -> None:
        """Register the end of a kernel's compilation; another may follow."""
        self._depth -= 1

    def stop(self) -> None:
        """End the countdown."""
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
        elapsed_s, used_s = time.monotonic() - self._begun[0], time.process_time() - self._begun[1]
        left_s = (self._expected_s - used_s) * max(
            (elapsed_s + _TIME_OFFSET_S) / (used_s + _TIME_OFFSET_S), 1.0
        )
        if left_s < _STEP:
            return "compiling, almost done"
        return f"compiling, about {_STEP * round(left_s / _STEP):.0f} s left"


def _ignore(_: str) -> None:
    """Discard a text."""


def _print_desk_text(_: str) -> None:
    print(DESK_TEXT, file=sys.stderr, flush=True)
