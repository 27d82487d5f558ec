# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The host's session with a scanner whose replies differ from those of the emulated one."""

from dataclasses import replace

import numpy as np
import pytest
from fixtures.driver_defaults import PLS

from trackslip_common.tally import Tally
from trackslip_drivers.protocols import sick_commands as commands
from trackslip_drivers.protocols.sick_scan import RawScan, ScanFault
from trackslip_drivers.protocols.sick_session import Phase, SessionFault, SickSession
from trackslip_drivers.protocols.sick_telegram import FROM_SENSOR, TO_SENSOR, make_telegram
from trackslip_drivers.sick_parameters import SickParameters

MS = 1_000_000
S = 1000 * MS
EPOCH_NS = 1_700_000_000 * S

OK, FAULT = b"\xa0\x00\x00", b"\xa0\x02\x00"
INSTALL = commands.installation_mode(b"SICK_PLS")
SET_BAUD = commands.set_baud(38400)


class Puppet:
    """A session whose scanner is played by the test; ``baud``: rate at which the session finds it."""

    def __init__(self, parameters: SickParameters = PLS, baud: int = 9600) -> None:
        self.session = SickSession(parameters, Tally())
        self.now_ns = EPOCH_NS
        self.baud = self.session.baud
        self.step(10)
        while self.baud != baud:
            self.step(10)

    def step(self, wait_ms: int) -> bytes:
        self.now_ns += wait_ms * MS
        action = self.session.step(self.now_ns)
        self.baud = action.baud or self.baud
        return action.write

    def answer(self, *telegrams: bytes, ack: bytes = b"\x06") -> bytes:
        """Acknowledge and answer a command after 30 ms; returns the next bytes that the session writes."""
        self.now_ns += 30 * MS
        self.session.receive(ack + b"".join(make_telegram(t, FROM_SENSOR) for t in telegrams), self.now_ns)
        return self.step(0)

    def count(self, fault: SessionFault) -> int:
        return self.session.tally.total["scan", fault.value]


def test_a_scanner_that_has_just_started_is_commanded_again() -> None:
    puppet = Puppet()
    assert puppet.answer(b"\x90PLS\x00", ack=b"") == make_telegram(commands.STOP, TO_SENSOR)
    assert puppet.baud == 9600
    assert puppet.answer(OK) == make_telegram(INSTALL, TO_SENSOR)


def test_the_rate_changes_also_when_only_its_acknowledgement_is_received() -> None:
    puppet = Puppet()
    assert puppet.answer(OK) == make_telegram(INSTALL, TO_SENSOR)
    assert puppet.answer(OK) == make_telegram(SET_BAUD, TO_SENSOR)
    assert puppet.answer() == b""
    assert puppet.step(240) == b""
    assert puppet.baud == 9600
    assert puppet.step(20) == b""
    assert puppet.baud == 38400
    assert puppet.step(240) == b""
    assert puppet.step(20) == make_telegram(commands.STOP, TO_SENSOR)


def test_without_a_pause_the_rate_changes_at_its_acknowledgement() -> None:
    puppet = Puppet(replace(PLS, baud_pause=0.0))
    puppet.answer(OK)
    puppet.answer(OK)
    assert puppet.answer() == make_telegram(commands.STOP, TO_SENSOR)
    assert puppet.baud == 38400


def test_a_late_reply_does_not_answer_the_next_command() -> None:
    puppet = Puppet()
    puppet.answer(OK)
    puppet.answer(OK)
    puppet.answer(OK)
    assert puppet.baud == 38400
    assert puppet.answer(OK) == b""
    assert puppet.step(260) == make_telegram(commands.STOP, TO_SENSOR)
    assert puppet.step(10) == b""
    assert puppet.session.phase is Phase.CHANGING_RATE


@pytest.mark.parametrize("accepted", [1, 2])
@pytest.mark.parametrize(("ack", "reply"), [(b"\x15", ()), (b"\x06", (FAULT,)), (b"\x06", (b"\x92\x00",))])
def test_a_refusal_starts_it_again(accepted: int, ack: bytes, reply: tuple[bytes, ...]) -> None:
    puppet = Puppet()
    for _ in range(accepted):
        puppet.answer(OK)
    assert puppet.answer(*reply, ack=ack) == make_telegram(commands.STOP, TO_SENSOR)
    assert puppet.session.phase is Phase.PROBING
    assert puppet.count(SessionFault.REFUSED if accepted == 1 else SessionFault.BAUD) == 1


def test_a_refusal_to_stream_starts_it_again() -> None:
    puppet = Puppet(baud=38400)
    assert puppet.answer(OK) == make_telegram(commands.STREAM_ALL, TO_SENSOR)
    puppet.answer(ack=b"\x15")
    assert puppet.session.phase is Phase.PROBING
    assert puppet.count(SessionFault.REFUSED) == 1


def test_unrequested_scans_are_counted() -> None:
    session = Puppet(baud=38400).session
    scan = RawScan(np.full(361, 500, dtype=np.uint16), status=0)
    assert session.receive(make_telegram(scan.payload(), FROM_SENSOR), EPOCH_NS + 300 * MS) == []
    assert session.tally.total["scan", ScanFault.NOT_STREAMING.value] == 1
