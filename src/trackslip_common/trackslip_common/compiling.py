# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Says that kernels are being compiled, once after an installation, and that nothing hangs."""

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

TEXT = "compiling, about a minute: once after an installation"
DESK_TEXT = "compiling for this processor, once after an installation: about two minutes"
_PERIOD = 1.0  # s


@contextmanager
def compilation_announced() -> Iterator[None]:
    """One line on stderr where what is done inside compiles: at once, though other lines are collected."""
    with compilation_reported(lambda _: print(DESK_TEXT, file=sys.stderr, flush=True), lambda _: None):
        yield


@contextmanager
def compilation_reported(log: Callable[[str], None], report: Callable[[str], None]) -> Iterator[None]:
    """Where what is done inside compiles, ``log`` gets one line, and ``report`` the same once a second.

    Kernels that are on the disk are only loaded: then nothing is said. ``report`` is called by a thread.
    """
    if "numba" not in sys.modules:  # a node without kernels
        yield
        return
    from numba.core import event  # not loaded for others

    ended = threading.Event()
    thread = threading.Thread(target=_repeat, args=(report, ended), name="compiling", daemon=True)

    class Listener(event.Listener):  # type: ignore[misc]  # numba has no types
        def on_start(self, _: Any) -> None:
            if thread.ident is None:
                log(TEXT)
                thread.start()

        def on_end(self, _: Any) -> None:
            """Another kernel may follow."""

    try:
        with event.install_listener("numba:compile", Listener()):
            yield
    finally:
        ended.set()
        if thread.ident is not None:
            thread.join()


def _repeat(report: Callable[[str], None], ended: threading.Event) -> None:
    while not ended.is_set():
        report(TEXT)
        ended.wait(_PERIOD)
