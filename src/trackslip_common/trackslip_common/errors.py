# SPDX-License-Identifier: Apache-2.0
"""The one error a user's input can cause, and the exit codes of every executable."""

from enum import IntEnum


class InputError(ValueError):
    """What the user gave cannot be used.

    Its text is the single line shown on stderr before leaving with ``ExitCode.BAD_INPUT``: it names the
    thing, the value given, and what is accepted.
    """


class ExitCode(IntEnum):
    """Exit codes of all executables."""

    DONE = 0
    FAILED = 1  # ran, and failed its check
    BAD_INPUT = 2
    INTERRUPTED = 130
