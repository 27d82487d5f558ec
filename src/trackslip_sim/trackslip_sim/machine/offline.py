# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Records a drive faster than real time: bytes of the emulator pass the drivers' protocols into a bag.

Devices, protocols, conversions and localizer are those of live operation; the clock is a counter. Each device
is read only when it has data. There are no ports and no processes, so each message is logged at the tick at
which its last byte arrives.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from trackslip_bags.messages import make
from trackslip_bags.writer import BagWriter
from trackslip_common.tally import Tally
from trackslip_common.units import NS_PER_S
from trackslip_common.vehicle_files import TOPIC as VEHICLE
from trackslip_common.vehicle_files import vehicle_text
from trackslip_drivers import conversions as of_sensors
from trackslip_drivers.protocols.excavator_can import ExcavatorCan
from trackslip_drivers.protocols.nmea_stream import FIX, HEADING, VELOCITY, NmeaStream, Sample
from trackslip_drivers.protocols.sick_session import Phase, SickSession
from trackslip_drivers.protocols.watson_stream import WatsonStream
from trackslip_drivers.records import FixSample, ImuSample, ScanSample, SprocketSample, VelocitySample
from trackslip_estimation.box import parameters as box_parameters
from trackslip_estimation.box.localizer import BoxFix, BoxLocalizer
from trackslip_estimation.box.parameters import BoxNodeParameters
from trackslip_estimation.box.scan import Scan
from trackslip_estimation.gnss import conversions as of_fixes
from trackslip_estimation.gnss import parameters as gnss_parameters
from trackslip_estimation.gnss.localizer import GnssLocalizer, Reason
from trackslip_estimation.gnss.parameters import GnssLocalizerParameters
from trackslip_estimation.slip import conversions as of_estimates
from trackslip_estimation.slip.measurements import PoseFix
from trackslip_sim.devices.line import NEVER_NS
from trackslip_sim.machine.bag_messages import Recording, Serialize, column_serializer, sensor_serializers
from trackslip_sim.machine.driver_settings import default_parameters
from trackslip_sim.machine.emulation import DRAIN_NS, SITE_FRAME, SOIL_NS, SWING_NS, TICK_NS, TRUTH_NS
from trackslip_sim.machine.excavator import EmulatedExcavator
from trackslip_sim.machine.faults import CAN, GNSS, SICK, WATSON
from trackslip_sim.machine.message_columns import Columns, stamp_columns
from trackslip_sim.machine.sensors import swing_topics
from trackslip_sim.machine.truth_messages import soil_message, swing_columns, truth_topics
from trackslip_sim.parameters import EmulatorParameters
from trackslip_sim.truth.record import WINDOW_LENGTH, Truth, TruthWindow

START_NS = 1_000_000_000  # start of the counted clock
_READ_PERIOD_NS = 100_000_000  # longest time between two reads of a port, as live
_WRITE_NS = round(0.5 * WINDOW_LENGTH * 1e9)  # between writes; the window must still hold the truth


def record_drive(
    p: EmulatorParameters,
    truth: Truth | TruthWindow,
    path: Path,
    advance: Callable[[float], None] = lambda _: None,
) -> dict[str, int]:
    """Write sensor data and truth of the drive to a bag; returns the messages per topic.

    ``advance`` is called with the number of simulated seconds since its last call, from power-on.

    Raises:
        InputError: the bag exists already.
    """
    window = truth if isinstance(truth, TruthWindow) else TruthWindow((truth,), truth.duration)
    with BagWriter(path) as bag:
        host = _Host(p, window, bag)
        done = START_NS // NS_PER_S
        while (now_ns := host.next_ns) <= host.excavator.end_ns + DRAIN_NS:
            host.step(now_ns)
            if (seconds := now_ns // NS_PER_S - done) > 0:
                advance(seconds)
                done += seconds
        host.recording.write()
    return bag.counts


@dataclass
class _Task:
    """A repeated task of the host."""

    step: Callable[[int], None]
    next_due_ns: Callable[[int], int]  # due time after a step
    due_ns: int = START_NS


class _Host:
    """The computer on the vehicle, connected to the devices without ports."""

    def __init__(self, p: EmulatorParameters, window: TruthWindow, bag: BagWriter) -> None:
        self.excavator = EmulatedExcavator(p, window, START_NS)
        self._window = window
        self._tally = Tally()
        self._drivers = drivers = self.excavator.drivers
        self._can = ExcavatorCan(drivers.can, drivers.frames, self._tally)
        self._imu = WatsonStream(drivers.layout, drivers.watson.serial_baud, 0, self._tally)
        self._session = SickSession(drivers.sick, self._tally)
        self._baud = self._session.baud
        box = default_parameters(BoxNodeParameters, box_parameters.NODE, *box_parameters.DEFAULT_FILES)
        self._vehicle = p.vehicle.whole()
        self._localizer = BoxLocalizer(box, p.vehicle.box)
        self._gnss = NmeaStream(drivers.nmea, self._tally)
        gnss = default_parameters(GnssLocalizerParameters, gnss_parameters.NODE)
        origin = {name: getattr(p.gnss, name) for name in ("latitude", "longitude", "altitude")}
        self._map = replace(gnss, **{f"datum_{name}": value for name, value in origin.items()})
        self._gnss_localizer = GnssLocalizer(self._map)
        self._body_frame = p.body_frame()
        self._truth = truth_topics(make, self._vehicle, self._body_frame)
        serializers = sensor_serializers(drivers.watson, self._body_frame) | self._truth_serializers()
        self.recording = Recording(bag, serializers)
        text = make("std_msgs/msg/String", data=vehicle_text(p.vehicle))
        self.recording.add(VEHICLE, text, START_NS)
        self._swings = swing_topics(p.vehicle)
        self._tasks = [
            _Task(self._receive_bus, partial(self._next_read_ns, CAN)),
            _Task(self._receive_inertial, partial(self._next_read_ns, WATSON)),
            _Task(self._exchange_with_scanner, self._next_scanner_read_ns),
            _Task(self._receive_gnss, partial(self._next_read_ns, GNSS)),
            _Task(self._record_truth, partial(self._next_period_ns, TRUTH_NS)),
            _Task(self._record_swing, partial(self._next_period_ns, SWING_NS)),
            _Task(lambda _: self.recording.write(), partial(self._next_period_ns, _WRITE_NS)),
        ]

    @property
    def next_ns(self) -> int:
        """The next tick at which a task is due."""
        return min([task.due_ns for task in self._tasks])

    def step(self, now_ns: int) -> None:
        """Run the tasks that are due, in their order."""
        for task in self._tasks:
            if task.due_ns <= now_ns:
                task.step(now_ns)
                task.due_ns = task.next_due_ns(now_ns)

    def _next_read_ns(self, sensor: str, now_ns: int) -> int:
        """The next tick at which a sensor is read."""
        requested_ns = min(self.excavator.next_ns(sensor, now_ns, TICK_NS), now_ns + _READ_PERIOD_NS)
        return now_ns + max(1, -((now_ns - requested_ns) // TICK_NS)) * TICK_NS

    def _next_scanner_read_ns(self, now_ns: int) -> int:
        """The next tick at which the scanner is read: every tick until it streams."""
        is_streaming = self._session.phase is Phase.STREAMING
        return self._next_read_ns(SICK, now_ns) if is_streaming else now_ns + TICK_NS

    def _next_period_ns(self, period_ns: int, now_ns: int) -> int:
        """One period later; ``NEVER_NS`` after the end of the drive."""
        next_ns = now_ns + period_ns
        return next_ns if next_ns <= self.excavator.end_ns else NEVER_NS

    def _receive_bus(self, now_ns: int) -> None:
        for frame in self.excavator.step_can(now_ns):
            for sample in self._can.receive(*frame, now_ns):
                topic = "sprockets" if isinstance(sample, SprocketSample) else "hydraulics"
                self.recording.add(topic, sample, now_ns)

    def _receive_inertial(self, now_ns: int) -> None:
        readings: Sequence[ImuSample] = self._imu.feed(self.excavator.step_watson(now_ns), now_ns)
        if self.excavator.inertial is not None:
            readings = self.excavator.step_inertial(now_ns)
        for reading in readings:
            self.recording.add("imu/data_raw", reading, now_ns)
            if reading.magnetic_field is not None:
                self.recording.add("imu/mag", reading, now_ns)

    def _receive_gnss(self, now_ns: int) -> None:
        sent = self.excavator.step_gnss(now_ns)
        for sample in self._gnss.feed(sent, now_ns) if sent else ():
            self._on_gnss(sample, now_ns)

    def _exchange_with_scanner(self, now_ns: int) -> None:
        arrived = self.excavator.step_sick(now_ns)
        if self._baud != self.excavator.sick.baud:
            arrived = b""
        for scan in self._session.receive(arrived, now_ns):
            self._on_scan(scan.sample, now_ns)
        action = self._session.step(now_ns)
        self._baud = action.baud or self._baud
        self.excavator.receive_sick(action.write, now_ns, self._baud)

    def _on_scan(self, scan: ScanSample, now_ns: int) -> None:
        message = of_sensors.laser_scan(make, scan, self._drivers.sick.frame_id)
        self.recording.add("scan", message, now_ns)
        ranges = np.asarray(message.ranges, dtype=np.float64)  # rounded as in the message
        geometry = (message.angle_min, message.angle_increment, message.time_increment)
        fix = self._localizer.locate(Scan(scan.stamp_ns, ranges, *geometry))
        if isinstance(fix, BoxFix):
            pose = PoseFix("box_pose", fix.stamp_ns, np.array((fix.x, fix.y, fix.yaw)), fix.covariance)
            message = of_estimates.pose_with_covariance(make, pose, SITE_FRAME)
            self.recording.add("box_pose", message, now_ns)

    def _on_gnss(self, sample: Sample, now_ns: int) -> None:
        receiver = self._drivers.nmea
        if isinstance(sample, VelocitySample):
            self.recording.add(VELOCITY, of_sensors.velocity(make, sample, receiver.frame_id), now_ns)
            return
        if not isinstance(sample, FixSample):
            self.recording.add(HEADING, of_sensors.heading(make, sample, receiver.heading_frame_id), now_ns)
            return
        message = of_sensors.nav_sat_fix(make, sample, receiver.frame_id)
        self.recording.add(FIX, message, now_ns)
        place = self._gnss_localizer.locate(of_fixes.fix(message))
        if not isinstance(place, Reason):
            pose = of_fixes.pose(make, place, "gnss_pose", self._map.map_frame)
            self.recording.add("gnss_pose", pose, now_ns)

    def _record_truth(self, now_ns: int) -> None:
        """Add the stamps of the truth; the truth is looked up when they are written."""
        since_ns = now_ns - START_NS
        self._window.advance(self.excavator.sensors.time(now_ns))
        for name, topic in self._truth.items():
            if since_ns % topic.period_ns == 0:
                self.recording.add(name, now_ns, now_ns)
        if since_ns % SOIL_NS == 0:
            at = self._window.truth.interpolate(self.excavator.sensors.time(now_ns))
            soil = soil_message(make, at, now_ns, self._vehicle, self._body_frame)
            self.recording.add("truth/soil", soil, now_ns)

    def _record_swing(self, now_ns: int) -> None:
        """Add the reading of the swing encoder and the stamp of the true swing."""
        self._window.advance(self.excavator.sensors.time(now_ns))
        for topic in self._swings:
            sample = self.excavator.sensors.swing(now_ns) if topic == "swing" else now_ns
            self.recording.add(topic, sample, now_ns)

    def _truth_serializers(self) -> dict[str, Serialize]:
        def columns_at(columns: Callable[[Truth], Columns]) -> Callable[[Sequence[int]], Columns]:
            def of_stamps(stamps_ns: Sequence[int]) -> Columns:
                times = [self.excavator.sensors.time(stamp_ns) for stamp_ns in stamps_ns]
                return {**stamp_columns(stamps_ns), **columns(self._window.truth.interpolate(times))}

            return of_stamps

        swing = column_serializer(of_sensors.blank_swing(make, self._body_frame), columns_at(swing_columns))
        serializers = {
            name: column_serializer(topic.blank, columns_at(topic.columns))
            for name, topic in self._truth.items()
        }
        return {**serializers, "truth/swing": swing}
