# SPDX-License-Identifier: Apache-2.0
"""A drive recorded faster than real time: the emulator's bytes through the drivers' protocols into a bag.

The same devices, protocols, conversions and localizer as live, on a clock that is only counted. There are no
ports and no processes, so each message is logged at the tick at which its last byte arrives.
"""

from pathlib import Path
from typing import Any

import numpy as np

from trackslip_bags.messages import make, serialize
from trackslip_bags.reader import absolute
from trackslip_bags.writer import BagWriter
from trackslip_common.config_files import config_file
from trackslip_common.tally import Tally
from trackslip_common.topics import TOPICS
from trackslip_drivers import conversions as of_sensors
from trackslip_drivers.can_parameters import CanDriverParameters
from trackslip_drivers.protocols.can_frames import FrameSet
from trackslip_drivers.protocols.excavator_can import ExcavatorCan
from trackslip_drivers.protocols.sick_session import SickSession
from trackslip_drivers.protocols.watson import Layout
from trackslip_drivers.protocols.watson_stream import WatsonStream
from trackslip_drivers.records import ScanSample, SprocketSample
from trackslip_drivers.sick_parameters import SickParameters
from trackslip_drivers.watson_parameters import WatsonParameters
from trackslip_estimation.box import parameters as box_parameters
from trackslip_estimation.box.localizer import BoxFix, BoxLocalizer
from trackslip_estimation.box.parameters import BoxNodeParameters
from trackslip_estimation.box.scan import Scan
from trackslip_estimation.slip import conversions as of_estimates
from trackslip_estimation.slip.measurements import PoseFix
from trackslip_sim.machine.excavator import EmulatedExcavator, default_parameters
from trackslip_sim.machine.truth_estimates import as_estimate, forces_message, soil_message
from trackslip_sim.parameters import EmulatorParameters
from trackslip_sim.truth.record import Truth

START_NS = 1_000_000_000  # of the counted clock
_TICK_NS = 2_000_000
_TRUTH_NS = 10_000_000
_FORCES_NS = 100_000_000
_SOIL_NS = 1_000_000_000
_BODY_FRAME, _SITE_FRAME = "base_link", "odom"


def record_drive(p: EmulatorParameters, truth: Truth, path: Path) -> dict[str, int]:
    """Write what the sensors see of the drive, and the truth; returns the messages per topic.

    Raises:
        InputError: the bag exists already.
    """
    with BagWriter(path) as bag:
        host = _Host(EmulatedExcavator(p, truth, START_NS), truth, bag)
        now_ns = START_NS
        while now_ns <= host.excavator.end_ns + round(1e9):
            host.step(now_ns)
            now_ns += _TICK_NS
    return bag.counts


class _Host:
    """The computer on the vehicle, with its ports joined straight to the devices."""

    def __init__(self, excavator: EmulatedExcavator, truth: Truth, bag: BagWriter) -> None:
        self.excavator = excavator
        self._truth = truth
        self._bag = bag
        self._tally = Tally()
        can = default_parameters(CanDriverParameters, "can_driver")
        self._can = ExcavatorCan(can, FrameSet(config_file(can.dbc_file)), self._tally)
        self._watson = default_parameters(WatsonParameters, "watson_imu")
        layout = Layout(self._watson.channels, self._watson.formats, self._watson.full_scales)
        self._imu = WatsonStream(layout, self._watson.serial_baud, 0, self._tally)
        self._sick = default_parameters(SickParameters, "sick_pls")
        self._session = SickSession(self._sick, self._tally)
        self._baud = self._session.baud
        box = default_parameters(BoxNodeParameters, box_parameters.NODE, *box_parameters.DEFAULT_FILES)
        self._vehicle = box.vehicle
        self._localizer = BoxLocalizer(box, box.vehicle)

    def step(self, now_ns: int) -> None:
        """All that arrives by now."""
        for frame in self.excavator.step_can(now_ns):
            self._on_frame(frame, now_ns)
        for sample in self._imu.feed(self.excavator.step_watson(now_ns), now_ns):
            p = self._watson
            stddevs = (p.linear_acceleration_stddev, p.angular_velocity_stddev)
            self._write("imu/data_raw", of_sensors.imu(make, sample, p.frame_id, *stddevs), now_ns)
            field = of_sensors.magnetic_field(make, sample, p.frame_id, p.magnetic_field_stddev)
            if field is not None:
                self._write("imu/mag", field, now_ns)
        self._talk_to_scanner(now_ns)
        if (now_ns - START_NS) % _TRUTH_NS == 0 and now_ns <= self.excavator.end_ns:
            self._tell_truth(now_ns)

    def _on_frame(self, frame: tuple[int, bytes], now_ns: int) -> None:
        sample = self._can.receive(*frame, now_ns)
        if isinstance(sample, SprocketSample):
            self._write("sprockets", of_sensors.joint_state(make, sample, _BODY_FRAME), now_ns)
        elif sample is not None:
            self._write("hydraulics", of_sensors.track_hydraulics(make, sample, _BODY_FRAME), now_ns)

    def _talk_to_scanner(self, now_ns: int) -> None:
        arrived = self.excavator.step_sick(now_ns)
        if self._baud != self.excavator.sick.baud:
            arrived = b""
        for scan in self._session.receive(arrived, now_ns):
            self._on_scan(scan.sample, now_ns)
        action = self._session.step(now_ns)
        self._baud = action.baud or self._baud
        self.excavator.hear_sick(action.write, now_ns, self._baud)

    def _on_scan(self, scan: ScanSample, now_ns: int) -> None:
        message = of_sensors.laser_scan(make, scan, self._sick.frame_id)
        self._write("scan", message, now_ns)
        ranges = np.asarray(message.ranges, dtype=np.float64)  # as rounded on the way to the localizer
        geometry = (message.angle_min, message.angle_increment, message.time_increment)
        fix = self._localizer.locate(Scan(scan.stamp_ns, ranges, *geometry))
        if isinstance(fix, BoxFix):
            pose = PoseFix("box_pose", fix.stamp_ns, np.array((fix.x, fix.y, fix.yaw)), fix.covariance)
            self._write("box_pose", of_estimates.pose_with_covariance(make, pose, _SITE_FRAME), now_ns)

    def _tell_truth(self, now_ns: int) -> None:
        at = self._truth.at(self.excavator.sensors.time(now_ns))
        estimate = as_estimate(at, now_ns)
        message = of_estimates.odometry(make, estimate, _SITE_FRAME, _BODY_FRAME)
        self._write("truth/odometry", message, now_ns)
        self._write("truth/track_slip", of_estimates.track_slip(make, estimate, _BODY_FRAME), now_ns)
        if (now_ns - START_NS) % _FORCES_NS == 0:
            forces = forces_message(make, at, now_ns, self._vehicle, _BODY_FRAME)
            self._write("truth/track_forces", forces, now_ns)
        if (now_ns - START_NS) % _SOIL_NS == 0:
            soil = soil_message(make, at, now_ns, self._vehicle, _BODY_FRAME)
            self._write("truth/soil", soil, now_ns)

    def _write(self, topic: str, message: Any, now_ns: int) -> None:
        self._bag.write(absolute(topic), TOPICS[topic].type_name, serialize(message), now_ns)
