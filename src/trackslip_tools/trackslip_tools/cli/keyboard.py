# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Single keys from the terminal, without waiting for them and without Enter."""

import os
import select
import sys
import termios
import tty
from types import TracebackType
from typing import Any


class Keyboard:
    """Gives what is typed key by key while it is open; nothing in a pipe or in the background."""

    def __init__(self) -> None:
        self._saved: list[Any] | None = None

    def __enter__(self) -> "Keyboard":
        if sys.stdin.isatty() and _is_in_front(sys.stdin.fileno()):
            self._saved = termios.tcgetattr(sys.stdin.fileno())
            tty.setcbreak(sys.stdin.fileno())
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._saved is not None:
            termios.tcsetattr(sys.stdin.fileno(), termios.TCSADRAIN, self._saved)
            self._saved = None

    def typed(self) -> str:
        """What was typed since this was last asked."""
        text = ""
        while self._saved is not None and select.select([sys.stdin], [], [], 0.0)[0]:
            key = os.read(sys.stdin.fileno(), 64)
            if not key:  # the terminal is gone
                break
            text += key.decode(errors="replace")
        return text


def _is_in_front(terminal: int) -> bool:
    """Whether we are the terminal's foreground job: any other is stopped if it touches the settings."""
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:  # a terminal, but not that of our session
        return False
