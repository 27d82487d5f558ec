# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``emulator``: an emulated excavator with bytes on a CAN bus and serial ports, truth on topics."""

import queue
import sys
import threading
import time
from functools import partial
from typing import Any

from rclpy.clock import Clock, ClockType

from trackslip_common.errors import InputError
from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.failures import describe_exception
from trackslip_common.nodes.health import ERROR, OK, WARN, Health
from trackslip_common.nodes.messages import make, topic_class
from trackslip_common.nodes.run import run
from trackslip_common.vehicle_files import TOPIC as VEHICLE
from trackslip_common.vehicle_files import vehicle_text
from trackslip_drivers.conversions import blank_swing, fill_swing
from trackslip_sim.machine.emulation import DRAIN_NS, SOIL_NS, SWING_NS, TICK_NS, TRUTH_NS
from trackslip_sim.machine.emulator_ports import EmulatorPorts
from trackslip_sim.machine.excavator import EmulatedExcavator, simulate_drive
from trackslip_sim.machine.faults import Fault, parse_fault
from trackslip_sim.machine.message_columns import set_fields, stamp_columns
from trackslip_sim.machine.sensors import swing_topics
from trackslip_sim.machine.truth_messages import soil_message, truth_topics
from trackslip_sim.nodes.remote_lifecycle import AwaitedNodes
from trackslip_sim.parameters import DEFAULT_FILES, NODE, EmulatorParameters

_CHECK_PERIOD = 0.2  # s between checks of the awaited nodes


class EmulatorNode(TrackslipNode[EmulatorParameters]):
    """``configure`` opens bus and ports, ``activate`` powers on, at once or after ``start_after``."""

    def __init__(self) -> None:
        super().__init__(NODE, EmulatorParameters, *DEFAULT_FILES)
        self._ports: EmulatorPorts | None = None
        self._awaited = AwaitedNodes(self, ())

    def configure(self) -> None:
        """Compute the drive, open the bus and the ports."""
        p = self.settings
        self._truth, self._vehicle = simulate_drive(p), p.vehicle.whole()
        self._vehicle_publisher = self.advertise(topic_class(VEHICLE), VEHICLE)
        self._excavator: EmulatedExcavator | None = None
        self._truth_topics = truth_topics(make, self._vehicle, p.body_frame())
        self._truth_publishers = {
            name: self.advertise(topic_class(name), name) for name in self._truth_topics
        }
        self._soil_publisher = self.advertise(topic_class("truth/soil"), "truth/soil")
        self._swing_publishers = {
            name: self.advertise(topic_class(name), name) for name in swing_topics(p.vehicle)
        }
        self._ports = EmulatorPorts(p)
        self._faults_refused = 0
        self.subscribe(topic_class("emulator/fault"), "emulator/fault", self._on_fault)

    def activate(self) -> None:
        """Power on, once the nodes of ``start_after`` are active."""
        self._awaited = AwaitedNodes(self, filter(None, self.settings.start_after))
        if not self._awaited.missing:
            self._power_on()
            return
        self.get_logger().info(self._waiting_text())
        self._check_timer = self.create_timer(
            _CHECK_PERIOD, self._check_awaited_nodes, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def _check_awaited_nodes(self) -> None:
        self._awaited.poll()
        if not self._awaited.missing:
            self.destroy_timer(self._check_timer)
            self._power_on()

    def _waiting_text(self) -> str:
        return (
            f"waiting for {', '.join(self._awaited.missing)} to be active before the machine is switched on"
        )

    def _power_on(self) -> None:
        self._vehicle_publisher.publish(make("std_msgs/msg/String", data=vehicle_text(self.settings.vehicle)))
        self._finished = False
        self._failure_text = ""
        self._stopping = threading.Event()
        self._requested_faults: queue.SimpleQueue[Fault] = queue.SimpleQueue()
        self._excavator = EmulatedExcavator(self.settings, self._truth, time.time_ns())
        self._thread = threading.Thread(
            target=self._run_devices, args=(self._excavator, self._ports), name="excavator", daemon=True
        )
        self._thread.start()

    def deactivate(self) -> None:
        """Power off."""
        if self._awaited.missing:
            self.destroy_timer(self._check_timer)
            self._awaited.close()
        if self._excavator is not None:
            self._stopping.set()
            self._thread.join()
            self._excavator = None

    def release(self) -> None:
        """Close bus and ports."""
        if self._ports is not None:
            self._ports.close()

    def health(self) -> list[Health]:
        """Number of emitted messages, active faults, and whether the drive is over."""
        if self._awaited.missing:
            return [Health(WARN, self._waiting_text())]
        if self._excavator is None or self._ports is None or not self.active:
            return [Health(OK, "inactive")]
        if self._failure_text:
            return [Health(ERROR, self._failure_text)]
        emitted = {f"emitted {topic}": n for topic, n in self._excavator.emitted().items()}
        active_faults = self._excavator.faults.active_faults(time.time_ns())
        values = {
            **emitted,
            "finished": self._finished,
            "bytes lost without a reader": self._ports.bytes_lost,
            "faults": "; ".join(map(str, active_faults)) or "none",
            "faults accepted": self._excavator.faults.added,
            "faults refused": self._faults_refused,
        }
        return [Health(OK, "finished" if self._finished else "driving", values)]

    def _on_fault(self, message: Any) -> None:
        """Add a fault from a YAML mapping as in ``faults`` of a scenario; without ``start``: from now on."""
        excavator = self._excavator
        if excavator is None:
            return
        try:
            self._requested_faults.put(parse_fault(message.data, excavator.faults.time(time.time_ns())))
        except InputError as error:
            self._faults_refused += 1
            self.get_logger().warning(str(error))

    def _run_devices(self, excavator: EmulatedExcavator, ports: EmulatorPorts) -> None:
        """Step the devices by the steady clock; the system clock is read once for the offset."""
        began_ns = time.monotonic_ns()
        epoch_ns = time.time_ns() - began_ns
        # Ticks coincide with the devices' cycles, which are whole ticks from the start of the drive.
        tick_ns = began_ns - (epoch_ns + began_ns - excavator.drive_start_ns) % TICK_NS
        truth_ns = epoch_ns + began_ns + TRUTH_NS // 2  # between two CAN frames, while the host is idle
        try:
            while not self._stopping.is_set():
                now_ns = epoch_ns + time.monotonic_ns()
                while not self._requested_faults.empty():
                    excavator.faults.add(self._requested_faults.get(), now_ns)
                ports.exchange(excavator, now_ns)
                while truth_ns <= min(now_ns, excavator.end_ns):
                    self._publish_truth(excavator, truth_ns)
                    truth_ns += TRUTH_NS
                self._finished = now_ns > excavator.end_ns + DRAIN_NS
                tick_ns += TICK_NS * max(1, (time.monotonic_ns() - tick_ns) // TICK_NS)
                self._stopping.wait(max(tick_ns - time.monotonic_ns(), 0) * 1e-9)
        except Exception as error:  # noqa: BLE001 (the thread ends, which /diagnostics must show)
            self._failure_text = f"stopped: {describe_exception(error)}"
            self.get_logger().error(self._failure_text)

    def _publish_truth(self, excavator: EmulatedExcavator, stamp_ns: int) -> None:
        at, stamp = self._truth.interpolate(excavator.sensors.time(stamp_ns)), stamp_columns([stamp_ns])
        since_ns = stamp_ns - excavator.drive_start_ns
        for name, topic in self._truth_topics.items():
            if since_ns % topic.period_ns < TRUTH_NS:
                set_fields(topic.blank, {**stamp, **topic.columns(at)})
                self._truth_publishers[name].publish(topic.blank)
        if since_ns % SWING_NS < TRUTH_NS:
            self._publish_swing(excavator, stamp_ns)
        if since_ns % SOIL_NS < TRUTH_NS:
            body_frame = self.settings.body_frame()
            self._soil_publisher.publish(soil_message(make, at, stamp_ns, self._vehicle, body_frame))

    def _publish_swing(self, excavator: EmulatedExcavator, stamp_ns: int) -> None:
        """Publish the swing encoder's reading, as its own computer does, and the true swing."""
        samples = {"swing": excavator.sensors.swing, "truth/swing": excavator.sensors.true_swing}
        blank = partial(blank_swing, make, self.settings.body_frame())
        for topic, publisher in self._swing_publishers.items():
            publisher.publish(fill_swing(blank(), samples[topic](stamp_ns)))


def main() -> None:
    """Entry point."""
    sys.exit(run(EmulatorNode))
