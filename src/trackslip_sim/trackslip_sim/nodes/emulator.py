# SPDX-License-Identifier: Apache-2.0
"""``emulator``: an excavator without one. Bytes on a CAN bus and two serial ports, truth on topics."""

import sys
import threading
import time
from pathlib import Path

from trackslip_common.nodes.base import ERROR, OK, Health, TrackslipNode
from trackslip_common.nodes.messages import make, topic_class
from trackslip_common.nodes.run import run
from trackslip_drivers.transports.can_bus import CanBus
from trackslip_estimation import conversions
from trackslip_sim.devices.pty_port import PtyPort
from trackslip_sim.excavator import EmulatedExcavator, drive
from trackslip_sim.parameters import DEFAULT_FILES, NODE, EmulatorParameters
from trackslip_sim.truth_estimates import as_estimate

_TICK_NS = 2_000_000  # how finely the serial lines are dripped
_TRUTH_PERIOD_NS = 10_000_000
_DRAIN_NS = 1_000_000_000  # after the end of the drive, for what is still on the lines
_FRAMES = ("odom", "base_link")


class EmulatorNode(TrackslipNode[EmulatorParameters]):
    """``configure`` lays the cables, ``activate`` turns the key."""

    def __init__(self) -> None:
        super().__init__(NODE, EmulatorParameters, *DEFAULT_FILES)

    def configure(self) -> None:
        """Compute the drive, open the bus and the ports."""
        p = self.settings
        self._truth = drive(p)
        self._finished = False
        self._failure = ""
        self._excavator: EmulatedExcavator | None = None
        self._stopping = threading.Event()
        self._odometry = self.announce(topic_class("truth/odometry"), "truth/odometry")
        self._track_slip = self.announce(topic_class("truth/track_slip"), "truth/track_slip")
        self._bus = CanBus(p.can_interface, p.can_channel, p.can_port)
        directory = Path(p.device_directory)
        self._watson_port, self._sick_port = PtyPort(directory / "watson"), PtyPort(directory / "sick")

    def activate(self) -> None:
        """Power on."""
        self._excavator = EmulatedExcavator(self.settings, self._truth, time.time_ns())
        self._thread = threading.Thread(
            target=self._live, args=(self._excavator,), name="excavator", daemon=True
        )
        self._thread.start()

    def deactivate(self) -> None:
        """Power off, pull the cables."""
        self._stopping.set()
        self._thread.join()
        self._bus.close()
        self._watson_port.close()
        self._sick_port.close()

    def health(self) -> list[Health]:
        """What was emitted so far, and whether the drive is over."""
        if self._excavator is None or not self.active:
            return [Health(OK, "inactive")]
        if self._failure:
            return [Health(ERROR, self._failure)]
        emitted = {f"emitted {topic}": n for topic, n in self._excavator.emitted().items()}
        lost = self._watson_port.bytes_lost + self._sick_port.bytes_lost
        began = self._excavator.drive_start_ns
        values = {
            **emitted,
            "drive start (ns)": began,
            "finished": self._finished,
            "bytes that nobody read": lost,
        }
        return [Health(OK, "finished" if self._finished else "driving", values)]

    def _live(self, excavator: EmulatedExcavator) -> None:
        """Pace the devices by the steady clock, from one reading of the system's."""
        began_ns = time.monotonic_ns()
        epoch_ns = time.time_ns() - began_ns
        tick_ns = began_ns
        truth_ns = epoch_ns + began_ns
        try:
            while not self._stopping.is_set():
                now_ns = epoch_ns + time.monotonic_ns()
                self._exchange(excavator, now_ns)
                while truth_ns <= min(now_ns, excavator.end_ns):
                    self._tell_truth(excavator, truth_ns)
                    truth_ns += _TRUTH_PERIOD_NS
                self._finished = now_ns > excavator.end_ns + _DRAIN_NS
                tick_ns = max(tick_ns + _TICK_NS, time.monotonic_ns() - _TICK_NS)
                self._stopping.wait(max(tick_ns - time.monotonic_ns(), 0) * 1e-9)
        except OSError as error:
            self._failure = f"stopped: {error}"
            self.get_logger().error(self._failure)

    def _exchange(self, excavator: EmulatedExcavator, now_ns: int) -> None:
        """Bytes both ways."""
        for frame in excavator.step_can(now_ns):
            self._bus.write(frame)
        excavator.watson.receive(self._watson_port.read(), now_ns)
        self._watson_port.write(excavator.step_watson(now_ns))
        excavator.sick.receive(self._sick_port.read(), now_ns, self._sick_port.baud)
        sent = excavator.step_sick(now_ns)
        if self._sick_port.baud == excavator.sick.baud:
            self._sick_port.write(sent)

    def _tell_truth(self, excavator: EmulatedExcavator, stamp_ns: int) -> None:
        estimate = as_estimate(self._truth.at(excavator.sensors.time(stamp_ns)), stamp_ns)
        self._odometry.publish(conversions.odometry(make, estimate, *_FRAMES))
        self._track_slip.publish(conversions.track_slip(make, estimate, _FRAMES[1]))


def main() -> None:
    """Entry point."""
    sys.exit(run(EmulatorNode))
