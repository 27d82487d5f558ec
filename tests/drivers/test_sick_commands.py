# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Replies of SICK scanners."""

import pytest

from trackslip_drivers.protocols.sick_commands import (
    CommandRefused,
    ModeChanged,
    ModeResult,
    PowerOn,
    Reply,
    ReplyFault,
    Report,
    ResetDone,
    parse_reply,
    set_baud,
)


@pytest.mark.parametrize(
    ("payload", "reply"),
    [
        (b"\xa0\x00\x00", ModeChanged(ModeResult.OK)),
        (b"\xa0\x01\x00", ModeChanged(ModeResult.WRONG_PASSWORD)),
        (b"\xa0\x02\x00", ModeChanged(ModeResult.FAULT)),
        (b"\x90LMS200;30106;V02.10 \x10", PowerOn("LMS200;30106;V02.10")),
        (b"\x91\x00", ResetDone()),
        (b"\x92\x00", CommandRefused()),
        (b"\xb1\x24\x07\x00", Report()),
        (b"\xb2\x02\x11\x04\x2a\x80", Report()),
    ],
)
def test_replies_are_understood(payload: bytes, reply: Reply) -> None:
    assert parse_reply(payload) == reply


@pytest.mark.parametrize(
    ("payload", "fault"),
    [
        (b"\xa0\x03\x00", ReplyFault.BAD_STRUCTURE),
        (b"\xa0", ReplyFault.BAD_STRUCTURE),
        (b"\xa0\x00\x00\x00", ReplyFault.BAD_STRUCTURE),
        (b"\xb7\x00", ReplyFault.UNKNOWN_CODE),
    ],
)
def test_other_replies_are_refused(payload: bytes, fault: ReplyFault) -> None:
    assert parse_reply(payload) is fault


def test_the_scanner_has_four_rates() -> None:
    with pytest.raises(KeyError):
        set_baud(115200)
