# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Commands to a SICK scanner, and decoding of its short replies.

Payloads only; ``make_telegram`` wraps them. A reply's code is the command's plus 0x80, and its last
byte is the scanner's status. ``sick_scan`` decodes scans (B0).
"""

from dataclasses import dataclass
from enum import Enum, IntEnum

# Commands, host to scanner. 0x20 changes the mode of operation.
STREAM_ALL = b"\x20\x24"  # all values, continuously
STREAM_MINIMA = b"\x20\x20"  # the nearest value of each degree, continuously
STOP = b"\x20\x25"  # values on request only
REQUEST_VALUES_LMS = b"\x30\x01"
REQUEST_VALUES_PLS = b"\x30\x05\xb4"
STATUS = b"\x31"
ERRORS = b"\x32"
RESET = b"\x10"

BAUD_CODES = {38400: 0x40, 19200: 0x41, 9600: 0x42, 500000: 0x48}
POWER_ON_BAUD = 9600
PASSWORDS = {"pls": b"SICK_PLS", "lms": b"SICK_LMS"}
_MODE = 0x20
_INSTALLATION = 0x00


class ReplyCode(IntEnum):
    """First byte of a scanner's telegram."""

    POWER_ON = 0x90
    RESET = 0x91
    REFUSED = 0x92
    MODE = 0xA0
    SCAN = 0xB0
    STATUS = 0xB1
    ERRORS = 0xB2


class ModeResult(IntEnum):
    """Result of a change of mode."""

    OK = 0
    WRONG_PASSWORD = 1
    FAULT = 2


class Severity(IntEnum):
    """Kind of an entry in the scanner's list of errors."""

    NONE = 0
    INFO = 1
    WARNING = 2
    ERROR = 3
    FATAL = 4


class ReplyFault(Enum):
    """Reason why a complete telegram was not decoded."""

    UNKNOWN_CODE = "unknown reply"
    BAD_STRUCTURE = "reply with the wrong structure"


@dataclass(frozen=True)
class PowerOn:
    """The scanner has started; it is at its power-on rate and in no measuring mode."""

    identity: str


@dataclass(frozen=True)
class ResetDone:
    """The scanner is about to restart."""


@dataclass(frozen=True)
class CommandRefused:
    """The scanner did not accept a command."""


@dataclass(frozen=True)
class ModeChanged:
    """Reply to a change of mode, including one of rate."""

    result: ModeResult


@dataclass(frozen=True)
class Report:
    """The scanner's status or its list of errors, which the driver does not request."""


Reply = PowerOn | ResetDone | CommandRefused | ModeChanged | Report


def installation_mode(password: bytes) -> bytes:
    """Command that opens the scanner's settings; every other change of mode closes them."""
    return bytes((_MODE, _INSTALLATION)) + password


def set_baud(baud: int) -> bytes:
    """Command that changes the scanner's rate.

    Raises:
        KeyError: the scanner has no such rate.
    """
    return bytes((_MODE, BAUD_CODES[baud]))


def parse_reply(payload: bytes) -> Reply | ReplyFault:
    """Decode any telegram of the scanner except a scan. ``payload`` is not empty."""
    code, content = payload[0], payload[1:-1]
    if code == ReplyCode.POWER_ON:
        return PowerOn(content.decode("ascii", errors="replace").strip())
    if code == ReplyCode.RESET:
        return ResetDone()
    if code == ReplyCode.REFUSED:
        return CommandRefused()
    if code in (ReplyCode.STATUS, ReplyCode.ERRORS):
        return Report()
    if code == ReplyCode.MODE:
        is_known = len(content) == 1 and content[0] in set(ModeResult)
        return ModeChanged(ModeResult(content[0])) if is_known else ReplyFault.BAD_STRUCTURE
    return ReplyFault.UNKNOWN_CODE
