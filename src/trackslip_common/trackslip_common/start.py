# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Starts an executable so that Ctrl-C is quiet from the first moment, while its imports are still loading."""

import atexit
import gc
import importlib
import os
import signal
import sys
from typing import Any, NoReturn

from trackslip_common.errors import ExitCode

_AGAIN = 0.1  # s
_END = 5.0  # s for libraries to clean up after themselves, which takes ms
_MANY = 1_000_000
_received: list[int] = []  # SIGINT, each time


class Interrupted(KeyboardInterrupt):
    """Ctrl-C.

    Python kills itself at its end if a ``KeyboardInterrupt``, of this very class, has left code that a string
    held (``exec`` of a library), whoever caught it.
    """


def start(module: str, interrupted: ExitCode = ExitCode.DONE) -> NoReturn:
    """Import ``module`` and leave with what its ``main`` returns, or as ``interrupted`` by an early Ctrl-C.

    A job that a shell put in the background ignores SIGINT from the start; here it receives it again. Of a
    library that is not installed one line says which.
    """
    signal.signal(signal.SIGINT, lambda *_: os._exit(interrupted))  # nothing is open yet
    try:
        main = importlib.import_module(module).main
    except ModuleNotFoundError as error:
        program = module.rpartition(".")[2]
        print(f"{program}: {error} (docs/install.md)", file=sys.stderr)
        sys.exit(ExitCode.BAD_INPUT)
    atexit.register(_limit_the_end)  # what is registered first is called last
    repeat_lost_interrupts()
    sys.exit(main())


def collect_garbage_seldom(objects: int = _MANY) -> None:
    """Only once so many objects were made, less those freed.

    With 700, Python's own number, it is an eighth of what the kernels take to compile, and with 50 000 still
    a twentieth of a short replay. But the more there are, the longer is the pause.
    """
    gc.set_threshold(objects)


def repeat_lost_interrupts() -> None:
    """Ctrl-C is not lost where a library calls back from machine code, as compilers do, or ends an object.

    There Python only prints that it ignored the exception: it is raised again a moment later, and what such
    places print of objects that were half made is not shown. Not at the end: then nobody catches it.
    """
    shown = sys.unraisablehook
    ends = False

    def interrupt(number: int, *_: object) -> None:
        _received.append(number)
        raise Interrupted

    def unraisable(lost: Any) -> None:
        if issubclass(lost.exc_type, KeyboardInterrupt):
            if not ends:
                signal.setitimer(signal.ITIMER_REAL, _AGAIN)
        elif not _received:
            shown(lost)

    @atexit.register
    def end() -> None:
        nonlocal ends
        ends = True
        signal.setitimer(signal.ITIMER_REAL, 0.0)

    signal.signal(signal.SIGINT, interrupt)
    signal.signal(signal.SIGALRM, interrupt)
    sys.unraisablehook = unraisable


def _limit_the_end() -> None:
    """After Python's own end an alarm kills a process that hangs in a library's clean-up.

    Fast DDS 2.14 waits there for a thread of its own, at full load and for ever, where another node leaves
    the graph at the wrong moment.
    """
    signal.setitimer(signal.ITIMER_REAL, _END)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)


def was_interrupted() -> bool:
    """Whether Ctrl-C came: what fails after that fails by it, as a compiler that lost it does."""
    return bool(_received)
