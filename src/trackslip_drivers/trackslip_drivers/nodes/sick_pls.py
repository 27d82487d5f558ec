# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``sick_pls``: the SICK PLS laser scanner on a serial line."""

import sys
import threading
import time
from collections.abc import Callable
from types import MappingProxyType

import numpy as np

from trackslip_common.nodes.health import ERROR, WARN, Health
from trackslip_common.nodes.messages import make, topic_class
from trackslip_common.nodes.run import run
from trackslip_drivers import conversions
from trackslip_drivers.nodes.driver import PORT_REMEDY, SerialDriverNode
from trackslip_drivers.protocols.sick_commands import Severity
from trackslip_drivers.protocols.sick_scan import DeviceStatus
from trackslip_drivers.protocols.sick_session import Phase, SessionFault, SickSession, scan_period
from trackslip_drivers.protocols.sick_telegram import TelegramFault
from trackslip_drivers.sick_parameters import SickParameters

_DIALOGUE_STEP = 0.01  # s between steps of the dialogue
_STREAMING_STEP = 0.1  # s between steps while scans come, which only detect a silent scanner
_STOP_TIMEOUT = 0.3  # s for the scanner to stop streaming


class SickNode(SerialDriverNode[SickParameters]):
    """Receives bytes; publishes ``scan``. A ``SickSession`` runs the dialogue with the scanner.

    The session alone detects silence, as a booting scanner is silent.
    """

    device = "SICK"
    remedies = MappingProxyType(
        {
            TelegramFault.BAD_CRC.value: "check the cable and its shield",
            TelegramFault.TRUNCATED.value: "check the cable",
            **dict.fromkeys((TelegramFault.GARBAGE.value, TelegramFault.BAD_LENGTH.value), PORT_REMEDY),
            SessionFault.NO_ANSWER.value: "check model, and both lines of the cable (RS-232 or RS-422)",
            SessionFault.BAUD.value: "set serial_baud to a rate that port and scanner support",
            SessionFault.SILENT.value: "check power and cable",
        }
    )

    def __init__(self) -> None:
        super().__init__("sick_pls", SickParameters, "sick_pls.yaml")

    def configure(self) -> None:
        """Prepare the dialogue."""
        super().configure()
        self.period = scan_period(self.settings, self.settings.serial_baud)
        self._lock = threading.Lock()  # the link's thread feeds the session, another thread steps it
        self._session = SickSession(self.settings, self.tally)
        self._scans = self.advertise(topic_class("scan"), "scan")
        self._scan_status = DeviceStatus.from_byte(0)  # of the last scan
        self._is_blind = False  # in the last scan

    def activate(self) -> None:
        """Open the link, and run the dialogue in a thread: an rclpy timer costs ten times as much."""
        self._ending = threading.Event()
        super().activate()
        step = self.callback_failures.guard(self._step_dialogue, "dialogue", recover=self.restart_decoding)
        self._dialogue_thread = threading.Thread(target=self._run_dialogue, args=(step,), daemon=True)
        self._dialogue_thread.start()

    def deactivate(self) -> None:
        """Stop the scanner's stream, then close the port."""
        self._ending.set()
        self._dialogue_thread.join()
        with self._lock:
            self._session.stop()
        deadline_s = time.monotonic() + _STOP_TIMEOUT
        while self._session.phase is not Phase.STOPPED and time.monotonic() < deadline_s:
            self._step_dialogue()
            time.sleep(_DIALOGUE_STEP)
        super().deactivate()

    def health(self) -> list[Health]:
        """The link's health, with the phase of the dialogue, a refused password or rate, and the status."""
        entries = super().health()
        phase, baud = self._session.phase, self._session.baud
        values = {"phase": phase.value, "rate (Bd)": baud, "discarded bytes": self._session.discarded_bytes}
        entries[0].values.update(values)
        if phase is Phase.FAILED:
            entries.append(Health(ERROR, phase.value, part="password"))
        if phase is Phase.STREAMING and baud != self.settings.serial_baud:
            refused = f"{self.settings.serial_baud} Bd refused: streaming at {baud} Bd"
            entries.append(Health(WARN, refused, part="rate"))
        return entries + self._status_health()

    def dialogue_state(self) -> str:
        """The phase of the dialogue."""
        return "" if self._session.phase is Phase.STREAMING else self._session.phase.value

    def _status_health(self) -> list[Health]:
        """Status that the scanner reported with its last scan."""
        status, entries = self._scan_status, []
        if status.severity >= Severity.WARNING:
            level = WARN if status.severity == Severity.WARNING else ERROR
            entries.append(Health(level, f"scanner reports: {status.severity_text}", part="status"))
        if status.implausible:
            entries.append(Health(ERROR, "scanner reports implausible values", part="implausible"))
        if status.restart:
            entries.append(Health(WARN, "scanner requests a restart, or has restarted", part="restart"))
        if status.pollution:
            entries.append(Health(WARN, "front window is dirty", part="pollution"))
        if self._is_blind:
            entries.append(Health(WARN, "all rays are dazzled or invalid; shade or clean it", part="rays"))
        return entries

    def restart_decoding(self) -> None:
        """Restart the dialogue, after a port was opened; during a deactivation, only stop the scanner."""
        with self._lock:
            self._session = SickSession(self.settings, self.tally)
            if self._ending.is_set():
                self._session.stop()
            self._scan_status, self._is_blind = DeviceStatus.from_byte(0), False

    def _run_dialogue(self, step: Callable[[], None]) -> None:
        while not self._ending.wait(
            _STREAMING_STEP if self._session.phase is Phase.STREAMING else _DIALOGUE_STEP
        ):
            step()

    def _step_dialogue(self) -> None:
        """Step the session, and carry out its action on the port."""
        now_ns = time.monotonic_ns()
        with self._lock:
            action = self._session.step(now_ns)
            if self._session.phase is Phase.STREAMING:
                self.period = scan_period(self.settings, self._session.baud)
        if action.baud is not None:
            baud = action.baud
            self.link.call_with_port(lambda port: port.set_baud(baud))
        if action.write:
            self.link.write(action.write)

    def receive(self, data: bytes, steady_ns: int) -> None:
        """Decode received bytes, and publish."""
        with self._lock:
            scans = self._session.receive(data, steady_ns)
        for scan in scans:
            self._scan_status = scan.status
            self._is_blind = bool(np.isnan(scan.sample.ranges).all())
            self._scans.publish(
                conversions.laser_scan(make, self.restamp(scan.sample), self.settings.frame_id)
            )
            self.count_message()


def main() -> None:
    """Entry point."""
    sys.exit(run(SickNode))
