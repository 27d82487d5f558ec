# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The host's session with the emulated scanner on a line with true rates, and with one that a test plays."""

import random
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fixtures.driver_defaults import LMS, PLS
from numpy.typing import NDArray

from trackslip_common.tally import Tally
from trackslip_drivers.protocols import sick_commands as commands
from trackslip_drivers.protocols.sick_scan import RawScan, Scan, ScanFault
from trackslip_drivers.protocols.sick_session import Phase, SessionFault, SickSession
from trackslip_drivers.protocols.sick_telegram import FROM_SENSOR, TO_SENSOR, make_telegram
from trackslip_drivers.sick_parameters import SickParameters
from trackslip_drivers.stamping import StampEvent
from trackslip_sim.devices import sick_device
from trackslip_sim.devices.line import BaudLine
from trackslip_sim.devices.sick_device import SickDevice, SickDeviceParameters

MS = 1_000_000
S = 1000 * MS
EPOCH_NS = 1_700_000_000 * S
TURN_NS = 40 * MS


def room(stamp_ns: int) -> NDArray[np.float64]:
    """Ranges, m, that identify the mirror turn; the first ray is NaN, the second infinite."""
    turn = (stamp_ns - EPOCH_NS) // TURN_NS
    ranges = 3.0 + 0.01 * ((np.arange(361, dtype=np.float64) + turn) % 500)
    ranges[:2] = [np.nan, np.inf]
    return ranges


class Bench:
    """A session and an emulated scanner on one line; the host polls every 1 to 10 ms."""

    def __init__(
        self,
        parameters: SickParameters = PLS,
        device_parameters: SickParameters | None = None,
        power_on_baud: int = 9600,
        boot_delay: float = 0.5,
        longest_poll_ns: int = 10 * MS,
    ) -> None:
        self.rng = random.Random(7)
        self.now_ns = EPOCH_NS
        self.longest_poll_ns = longest_poll_ns
        self.host_baud = parameters.serial_baud
        self.uplink = BaudLine(self.host_baud, parameters.bits_per_char)
        self.session = SickSession(parameters, Tally())
        start = SickDeviceParameters(boot_delay=boot_delay, power_on_baud=power_on_baud)
        self.device = SickDevice(device_parameters or parameters, start, room, self.now_ns)
        self.scans: list[Scan] = []
        self.plugged = True

    def poll(self) -> None:
        self.now_ns += self.rng.randrange(MS, self.longest_poll_ns)
        self.device.receive(self.uplink.read(self.now_ns), self.now_ns, self.host_baud)
        data = self.device.step(self.now_ns)
        if self.device.baud != self.host_baud:
            data = self.rng.randbytes(len(data))
        self.scans += self.session.receive(data if self.plugged else b"", self.now_ns)
        action = self.session.step(self.now_ns)
        if action.baud is not None:
            self.host_baud = self.uplink.baud = action.baud
        self.uplink.send(action.write, self.now_ns)

    def run(self, seconds: float) -> None:
        end_ns = self.now_ns + round(seconds * S)
        while self.now_ns < end_ns:
            self.poll()

    def run_until(self, phase: Phase, within: float) -> float:
        began_ns = self.now_ns
        while self.session.phase is not phase:
            assert self.now_ns - began_ns < within * S, f"still {self.session.phase}"
            self.poll()
        return (self.now_ns - began_ns) / S

    def stall_host(self, seconds: float) -> None:
        """Stop the host for so long; the bytes that arrive meanwhile are then read 4096 at a time."""
        end_ns, waiting = self.now_ns + round(seconds * S), b""
        while self.now_ns < end_ns:
            self.now_ns += 5 * MS
            waiting += self.device.step(self.now_ns)
        while waiting:
            self.now_ns += 6 * MS
            waiting += self.device.step(self.now_ns)
            self.scans += self.session.receive(waiting[:4096], self.now_ns)
            waiting = waiting[4096:]

    def count(self, fault: SessionFault) -> int:
        return self.session.tally.total["scan", fault.value]


def streaming(parameters: SickParameters = PLS, **more: Any) -> Bench:
    """A bench whose session starts streaming within 3 s."""
    bench = Bench(parameters, **more)
    bench.run_until(Phase.STREAMING, within=3.0)
    return bench


@pytest.mark.parametrize(
    ("parameters", "power_on_baud"), [(LMS, 9600), *((PLS, baud) for baud in sorted(commands.BAUD_CODES))]
)
def test_starts_from_any_rate(parameters: SickParameters, power_on_baud: int) -> None:
    bench = streaming(parameters, power_on_baud=power_on_baud)
    bench.run(2.0)
    assert bench.device.baud == bench.host_baud == 38400
    assert len(bench.scans) == bench.device.scans_emitted >= 7
    assert bench.count(SessionFault.REFUSED) == 0


@pytest.mark.parametrize("baud", sorted(commands.BAUD_CODES))
def test_streams_at_any_rate(baud: int) -> None:
    bench = streaming(replace(PLS, serial_baud=baud))
    bench.run(4.0)
    turns_per_scan = {9600: 21, 19200: 11, 38400: 6, 500000: 1}[baud]
    assert np.unique(np.diff(bench.device.stamps)).tolist() == [turns_per_scan * TURN_NS]
    assert len(bench.scans) == bench.device.scans_emitted


@pytest.mark.parametrize("longest_poll_ms", [2, 30])
def test_stamps_and_ranges_are_those_of_the_sweep(longest_poll_ms: int) -> None:
    bench = streaming(longest_poll_ns=longest_poll_ms * MS)
    bench.run(6.0)
    assert len(bench.scans) > 20
    for scan, stamp_ns in zip(bench.scans, bench.device.stamps, strict=True):
        assert abs(scan.sample.stamp_ns - stamp_ns) <= 5 * MS
        np.testing.assert_allclose(scan.sample.ranges, room(stamp_ns), atol=1e-9)


@pytest.mark.parametrize(("baud", "stall_s"), [(9600, 5.0), (38400, 0.5), (500000, 0.5), (500000, 20.0)])
def test_scans_read_after_a_host_stall_are_stamped_at_their_measurement(baud: int, stall_s: float) -> None:
    """Each stamp is within 5 ms of the true time of its sweep."""
    bench = streaming(replace(PLS, serial_baud=baud))
    bench.run(2.0)
    bench.stall_host(stall_s)
    bench.run(5.0)
    for scan in bench.scans:
        stamp_ns = min(bench.device.stamps, key=lambda true_ns: abs(true_ns - scan.sample.stamp_ns))
        assert abs(scan.sample.stamp_ns - stamp_ns) <= 5 * MS
        np.testing.assert_allclose(scan.sample.ranges, room(stamp_ns), atol=1e-9)
    assert bench.now_ns - bench.scans[-1].sample.stamp_ns < 2 * S
    assert bench.count(SessionFault.SILENT) == 0
    assert bench.session.tally.total["scan", StampEvent.DELAYED.value] > 0


@pytest.mark.parametrize("boot_delay", [0.0, 15.0])
def test_waits_for_a_scanner_that_boots(boot_delay: float) -> None:
    bench = Bench(boot_delay=boot_delay)
    elapsed = bench.run_until(Phase.STREAMING, within=boot_delay + 3.0)
    assert elapsed > boot_delay
    assert (bench.count(SessionFault.NO_ANSWER) > 0) == (boot_delay > 0)


@pytest.mark.parametrize("baud", [9600, 38400])
def test_connects_to_a_scanner_that_already_streams(baud: int) -> None:
    bench = streaming(replace(PLS, serial_baud=baud))
    bench.run(2.0)
    bench.session = SickSession(PLS, Tally())
    bench.host_baud = bench.uplink.baud = bench.session.baud
    bench.run_until(Phase.STREAMING, within=6.0)
    before = len(bench.scans)
    bench.run(1.0)
    assert len(bench.scans) > before + 2


@pytest.mark.parametrize("off_s", [0.02, 4.0])
@pytest.mark.parametrize("baud", [38400, 500000])
def test_scans_come_within_a_second_of_the_end_of_a_boot(baud: int, off_s: float) -> None:
    bench = streaming(replace(PLS, serial_baud=baud), boot_delay=1.3)
    bench.run(1.0)
    bench.plugged = False
    bench.run(off_s)
    bench.plugged = True
    bench.device.power_cycle(bench.now_ns)
    before, ready_ns = len(bench.scans), bench.now_ns + 1300 * MS
    while len(bench.scans) == before:
        bench.poll()
        assert bench.now_ns < ready_ns + S
    assert bench.count(SessionFault.SILENT) == 1


def test_restarts_at_once_when_the_scanner_reports_a_restart() -> None:
    bench = streaming(power_on_baud=38400)
    bench.device.power_cycle(bench.now_ns)
    bench.run(1.2)
    assert bench.session.phase is Phase.STREAMING
    assert bench.count(SessionFault.RESTARTED) == 1


def test_waits_for_a_scanner_that_is_slow_to_change_its_mode(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sick_device, "_REPLY_DELAY_NS", 2500 * MS)
    bench = Bench()
    bench.run_until(Phase.STREAMING, within=25.0)
    bench.run(1.0)
    assert len(bench.scans) > 2


def test_a_refused_password_is_tried_again_after_a_pause() -> None:
    bench = Bench(PLS, device_parameters=replace(LMS, parity="E"))
    bench.run_until(Phase.FAILED, within=3.0)
    bench.run(9.0)
    assert bench.session.phase is Phase.FAILED
    bench.run(5.0)
    assert bench.count(SessionFault.PASSWORD) == 2
    assert bench.device.scans_emitted == 0
    start = SickDeviceParameters(boot_delay=0.0, power_on_baud=9600)
    bench.device = SickDevice(PLS, start, room, bench.now_ns)
    bench.run_until(Phase.STREAMING, within=10.0)


def test_stops_the_scanner_before_leaving() -> None:
    bench = streaming()
    bench.run(1.1)
    bench.session.stop()
    bench.run_until(Phase.STOPPED, within=0.5)
    emitted = bench.device.scans_emitted
    bench.run(1.0)
    assert bench.device.scans_emitted == emitted
    assert bench.session.phase is Phase.STOPPED
    absent = Bench(boot_delay=60.0)
    absent.session.stop()
    absent.run_until(Phase.STOPPED, within=0.1)  # no longer than an acknowledgement takes


def test_refused_rate_is_replaced_by_the_next_lower_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """An RS-232 line has no 500000 Bd: the scanner streams at the next lower rate."""
    bauds = {code: baud for baud, code in commands.BAUD_CODES.items() if baud != 500000}
    monkeypatch.setattr(sick_device, "_BAUDS", bauds)
    bench = Bench(replace(PLS, serial_baud=500000))
    bench.run_until(Phase.STREAMING, within=6.0)
    assert bench.device.baud == bench.host_baud == 38400
    assert bench.count(SessionFault.BAUD) == 2
    bench.run(3.0)
    assert len(bench.scans) == bench.device.scans_emitted > 8


def test_a_line_that_does_not_carry_a_rate_is_used_at_a_lower_one() -> None:
    bench = Bench(replace(PLS, serial_baud=500000))
    receive = bench.device.receive

    def deaf(data: bytes, now_ns: int, host_baud: int | None) -> None:
        receive(b"" if bench.device.baud == 500000 else data, now_ns, host_baud)

    bench.device.receive = deaf  # type: ignore[method-assign]
    for _ in range(2):
        bench.run_until(Phase.CHANGING_RATE, within=15.0)
        bench.run_until(Phase.PROBING, within=5.0)
        bench.device.power_cycle(bench.now_ns)  # otherwise the device would stay at another rate
    bench.run_until(Phase.STREAMING, within=15.0)
    assert bench.host_baud == 38400


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


def test_unrequested_scans_are_counted_and_a_refusal_to_stream_starts_it_again() -> None:
    puppet = Puppet(baud=38400)
    scan = RawScan(np.full(361, 500, dtype=np.uint16), status=0)
    assert puppet.answer(OK, scan.payload()) == make_telegram(commands.STREAM_ALL, TO_SENSOR)
    assert puppet.session.tally.total["scan", ScanFault.NOT_STREAMING.value] == 1
    puppet.answer(ack=b"\x15")
    assert puppet.session.phase is Phase.PROBING
    assert puppet.count(SessionFault.REFUSED) == 1


def test_damaged_scans_are_counted_by_their_checksum_and_not_by_their_bytes() -> None:
    bench = Bench()
    bench.run_until(Phase.STREAMING, 30.0)
    bench.session.tally.new_counts()
    receive = bench.session.receive

    def receive_damaged(data: bytes, arrival_ns: int) -> list[Scan]:
        return receive(bytes(byte ^ (bench.rng.random() < 1e-3) for byte in data), arrival_ns)

    bench.session.receive = receive_damaged  # type: ignore[method-assign]
    bench.run(5.0)
    counts = bench.session.tally.new_counts()
    assert max(counts, key=lambda key: counts[key]) == ("scan", "bad CRC")
    assert sum(counts.values()) < 60
