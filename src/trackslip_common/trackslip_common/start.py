# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Starts an executable so that Ctrl-C is quiet from the beginning, even while its imports load."""

import atexit
import contextlib
import gc
import importlib
import os
import signal
import sys
from typing import Any, NoReturn

from trackslip_common.errors import ExitCode

_REPEAT_DELAY = 0.1  # s until a lost interrupt is raised again
_GARBAGE_THRESHOLD = 1_000_000
_received_signals: list[int] = []  # each SIGINT
_exit_codes: list[int] = []


class Interrupted(KeyboardInterrupt):
    """Ctrl-C.

    Python kills its process at the end if an exception of exactly the class ``KeyboardInterrupt`` has left
    code from a string (``exec`` of a library), even if it was caught.
    """


def start(module: str, interrupt_code: ExitCode = ExitCode.DONE) -> NoReturn:
    """Import ``module`` and exit with the result of its ``main``; ``interrupt_code``: after an early Ctrl-C.

    A background job of a shell ignores SIGINT from the start; here it receives SIGINT again. A library that
    is not installed is named in one line.
    """
    signal.signal(signal.SIGINT, lambda *_: os._exit(interrupt_code))  # nothing is open yet
    atexit.register(_end_process)  # registered first, called last
    try:
        main = importlib.import_module(module).main
    except ModuleNotFoundError as error:
        program = module.rpartition(".")[2]
        print(f"{program}: {error} (docs/install.md)", file=sys.stderr)
        _exit(ExitCode.BAD_INPUT)
    repeat_lost_interrupts()
    try:
        code = main()
    except SystemExit as error:
        code = error.code
    _exit(code)


def collect_garbage_seldom(objects: int = _GARBAGE_THRESHOLD) -> None:
    """Collect garbage only after so many allocations, less deallocations.

    With Python's own 700, collections take an eighth of the compile time of the kernels; with 50 000, still a
    twentieth of a short replay. A larger number makes each pause longer.
    """
    gc.set_threshold(objects)


def repeat_lost_interrupts() -> None:
    """Raise Ctrl-C again if it is lost in a callback from machine code, as in compilers, or in a finalizer.

    Python only prints that it ignored the exception. It is raised again a moment later, and messages about
    incomplete objects are hidden. At the end of the process nothing would catch it, so it is not raised.
    """
    hook = sys.unraisablehook
    is_ending = False

    def interrupt(number: int, *_: object) -> None:
        _received_signals.append(number)
        raise Interrupted

    def unraisable(lost: Any) -> None:
        if issubclass(lost.exc_type, KeyboardInterrupt):
            if not is_ending:
                signal.setitimer(signal.ITIMER_REAL, _REPEAT_DELAY)
        elif not _received_signals:
            hook(lost)

    @atexit.register
    def end() -> None:
        nonlocal is_ending
        is_ending = True
        signal.setitimer(signal.ITIMER_REAL, 0.0)

    signal.signal(signal.SIGINT, interrupt)
    signal.signal(signal.SIGALRM, interrupt)
    sys.unraisablehook = unraisable


def _exit(code: str | int | None) -> NoReturn:
    """End as ``sys.exit`` does."""
    _exit_codes.append(code if isinstance(code, int) else int(code is not None))
    sys.exit(code)


def _end_process() -> None:
    """End the process before libraries clean up, which may hang: after an exception with code 1.

    Fast DDS 2.14 waits there for its own thread, at full load and forever, if another node leaves the graph
    at the wrong moment. Python has ended its threads and called all other exit handlers before.
    """
    with contextlib.suppress(OSError, ValueError):  # the reader has gone
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(_exit_codes[-1] if _exit_codes else 1)


def was_interrupted() -> bool:
    """Whether Ctrl-C was received: it causes later failures, as in a compiler that lost it."""
    return bool(_received_signals)
