# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The emulated excavator: devices that send bytes, measured from one true drive. No port, no clock."""

import math
from collections.abc import Callable

from trackslip_common.arrays import FloatArray
from trackslip_common.units import GRAVITY
from trackslip_common.vehicle import UNDERCARRIAGE, UPPER, VehicleParameters
from trackslip_drivers.protocols.watson import BITS_PER_CHAR, TESLA_PER_MILLIGAUSS
from trackslip_drivers.records import ImuSample
from trackslip_sim.devices.can_device import ENCODERS, PRESSURES, CanDevice
from trackslip_sim.devices.line import NEVER_NS, BaudLine
from trackslip_sim.devices.nmea_device import NmeaDevice
from trackslip_sim.devices.sick_device import SickDevice
from trackslip_sim.devices.watson_device import WatsonDevice
from trackslip_sim.machine.driver_settings import DriverSettings, default_drivers
from trackslip_sim.machine.faults import CAN, GNSS, POWER_CYCLE, SICK, UNPLUG, WATSON, WRONG_BAUD, Faults
from trackslip_sim.machine.faulty_line import FaultyBus, FaultySerial
from trackslip_sim.machine.faulty_readings import FaultyReadings, FullScales
from trackslip_sim.machine.gnss_model import GnssModel
from trackslip_sim.machine.scan_model import SiteScanner
from trackslip_sim.machine.sensors import MachineSensors, mounting_of
from trackslip_sim.parameters import EmulatorParameters
from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_sim.truth.record import Truth, TruthWindow
from trackslip_sim.truth.simulate import simulate


class InertialUnit:
    """An inertial unit that samples at ``rate`` Hz from ``start_ns`` on; ``measure`` reads it at a stamp."""

    def __init__(self, rate: float, measure: Callable[[int], ImuSample], start_ns: int) -> None:
        self._period_ns = round(1e9 / rate)
        self._measure = measure
        self.next_ns = start_ns

    def step(self, now_ns: int, powered: bool) -> list[ImuSample]:
        """The samples due by now; none without ``powered``."""
        samples = []
        while self.next_ns <= now_ns:
            if powered:
                samples.append(self._measure(self.next_ns))
            self.next_ns += self._period_ns
        return samples


def simulate_drive(p: EmulatorParameters) -> Truth:
    """The true motion of the drive in the parameters.

    Raises:
        InputError: scenario, soil or terrain is unknown, or refused.
    """
    scenario = load_scenario(p.scenario, p.terrain, p.duration)
    whole, upper = p.vehicle.whole(), p.vehicle.upper_structure
    return simulate(scenario, soil=p.soil or None, mode=p.mode, vehicle=whole, upper=upper)


class EmulatedExcavator:
    """The devices, powered from ``start_ns``; they measure ``truth`` from ``drive_start_ns`` on.

    Each device has the settings of its driver, ``drivers``, and the failures in ``faults``. A machine
    with another inertial unit than a Watson has both; ``offline`` reads ``inertial``, without a port.
    """

    def __init__(self, p: EmulatorParameters, truth: Truth | TruthWindow, start_ns: int) -> None:
        window = truth if isinstance(truth, TruthWindow) else TruthWindow((truth,), truth.duration)
        self.drive_start_ns = start_ns + round(p.lead_in * 1e9)
        self.end_ns = self.drive_start_ns + round(window.duration * 1e9)
        mounting = mounting_of(p.vehicle)
        self.sensors = MachineSensors(window, p.noise, self.drive_start_ns, p.seed, mounting)
        self._poses_of = {UNDERCARRIAGE: self.sensors.pose_at, UPPER: self.sensors.upper_pose_at}
        self._placement_of = {UNDERCARRIAGE: self.sensors.placement, UPPER: self.sensors.upper_placement}
        self._vehicle = p.vehicle
        self.faults = Faults(load_scenario(p.scenario).faults, self.drive_start_ns)
        self.drivers = drivers = default_drivers()
        self._scanner = SiteScanner(p.site, p.vehicle.box, p.seed)
        self._readings = readings = FaultyReadings(
            self.faults, self.sensors, self._scan, _full_scales(drivers), p.seed
        )
        boot_ns = round(p.can_delay * 1e9)
        measures = (readings.sprockets, readings.hydraulics)
        self.can = CanDevice(drivers.frames, *measures, start_ns + boot_ns)
        self._watson_line = BaudLine(drivers.watson.serial_baud, BITS_PER_CHAR)
        self.watson = WatsonDevice(drivers.layout, self._watson_line, readings.imu, True, start_ns)
        self.inertial = _inertial_unit(p.vehicle, readings.imu, start_ns)
        self.sick = SickDevice(drivers.sick, p.sick_start, readings.ranges, start_ns)
        self._gnss_line = BaudLine(drivers.nmea.serial_baud, BITS_PER_CHAR)
        placement = self._placement_of[p.vehicle.mount_of("antenna")]
        antenna = GnssModel(p.mounted_gnss(), placement, self.faults, p.seed)
        self.gnss = NmeaDevice(p.gnss.device, self._gnss_line, antenna.measure, start_ns, p.seed)
        self._next_step_ns: dict[str, Callable[[int, int], int]] = {
            CAN: lambda *_: self.can.next_ns,
            WATSON: self._next_inertial_ns,
            SICK: self.sick.next_ns,
            GNSS: self.gnss.next_ns,
        }
        self._power_on: dict[str, Callable[[int], None]] = {
            CAN: lambda now_ns: self.can.start(now_ns + boot_ns),
            WATSON: self.watson.power_cycle,
            SICK: self.sick.power_cycle,
            GNSS: self.gnss.power_cycle,
        }
        self._unpowered_sensors: set[str] = set()
        self._bus = FaultyBus(CAN, self.faults, p.seed)
        self._lines = {sensor: FaultySerial(sensor, self.faults, p.seed) for sensor in (WATSON, SICK, GNSS)}

    def next_ns(self, sensor: str, now_ns: int, tick_ns: int) -> int:
        """Next time to step a sensor, whole ticks from now, for the same result as stepping at each tick."""
        if self.faults:
            return now_ns + tick_ns
        if now_ns < self.end_ns:
            return self._next_step_ns[sensor](now_ns, tick_ns)
        draining = {WATSON: self._watson_line, GNSS: self._gnss_line}
        return draining[sensor].next_read_ns(now_ns, tick_ns) if sensor in draining else NEVER_NS

    def step_can(self, now_ns: int) -> list[tuple[int, bytes]]:
        """Frames due by now."""
        frames = self.can.step(min(now_ns, self.end_ns)) if self._update_power(CAN, now_ns) else []
        return self._bus.transmit(frames, now_ns)

    def step_watson(self, now_ns: int) -> bytes:
        """Characters sent by now; the last line is completed after the end of the drive."""
        return self._step_serial(WATSON, self.watson, self._watson_line, now_ns)

    def step_inertial(self, now_ns: int) -> list[ImuSample]:
        """Samples due by now of an inertial unit other than a Watson; faults of bytes do not apply."""
        if self.inertial is None:
            return []
        return self.inertial.step(min(now_ns, self.end_ns), self._can_receive(WATSON, now_ns))

    def step_sick(self, now_ns: int) -> bytes:
        """Characters sent by now."""
        self.sick.status = self._readings.status(now_ns)
        on = self._update_power(SICK, now_ns) and now_ns < self.end_ns
        return self._lines[SICK].transmit(self.sick.step(now_ns) if on else b"", now_ns)

    def step_gnss(self, now_ns: int) -> bytes:
        """Characters sent by now; the last burst is completed after the end of the drive."""
        return self._step_serial(GNSS, self.gnss, self._gnss_line, now_ns)

    def receive_watson(self, data: bytes, now_ns: int) -> None:
        """Pass bytes from the host to the inertial unit."""
        if data and self._can_receive(WATSON, now_ns):
            self.watson.receive(data, now_ns)

    def receive_sick(self, data: bytes, now_ns: int, host_baud: int | None) -> None:
        """Pass bytes from the host, sent at ``host_baud`` Bd, to the scanner."""
        if data and self._can_receive(SICK, now_ns):
            self.sick.receive(data, now_ns, host_baud)

    def emitted(self) -> dict[str, int]:
        """Number of messages sent so far per sensor topic, received or not."""
        frames, lines = self.can.frames_emitted, self.watson.lines_emitted
        return {
            "sprockets": frames[ENCODERS],
            "hydraulics": frames[PRESSURES],
            "imu/data_raw": lines,
            "imu/mag": lines,
            "scan": self.sick.scans_emitted,
            "fix": self.gnss.fixes_emitted,
            "fix_velocity": self.gnss.velocities_emitted,
            "heading": self.gnss.headings_emitted,
        }

    def _next_inertial_ns(self, now_ns: int, tick_ns: int) -> int:
        next_ns = self.watson.next_ns(now_ns, tick_ns)
        return next_ns if self.inertial is None else min(next_ns, self.inertial.next_ns)

    def _step_serial(
        self, sensor: str, device: WatsonDevice | NmeaDevice, line: BaudLine, now_ns: int
    ) -> bytes:
        sent = b""
        if self._update_power(sensor, now_ns):
            sent = device.step(now_ns) if now_ns < self.end_ns else line.read(now_ns)
        return self._lines[sensor].transmit(sent, now_ns)

    def _scan(self, stamp_ns: int) -> FloatArray:
        poses = self._poses_of[self._vehicle.mount_of("box")]
        return self._scanner.scan(self.sensors.time(stamp_ns), poses)

    def _update_power(self, sensor: str, now_ns: int) -> bool:
        """Whether the sensor has power; boots it when the power returns."""
        if self.faults.active_fault(sensor, POWER_CYCLE, now_ns) is not None:
            self._unpowered_sensors.add(sensor)
        elif sensor in self._unpowered_sensors:
            self._unpowered_sensors.remove(sensor)
            self._power_on[sensor](now_ns)
        return sensor not in self._unpowered_sensors

    def _can_receive(self, sensor: str, now_ns: int) -> bool:
        is_disconnected = any(
            self.faults.active_fault(sensor, kind, now_ns) is not None for kind in (UNPLUG, WRONG_BAUD)
        )
        return self._update_power(sensor, now_ns) and not is_disconnected


def _inertial_unit(
    vehicle: VehicleParameters, measure: Callable[[int], ImuSample], start_ns: int
) -> InertialUnit | None:
    imu = vehicle.sensors.imu if vehicle.sensors is not None else None
    return None if imu is None else InertialUnit(imu.rate, measure, start_ns)


def _full_scales(drivers: DriverSettings) -> FullScales:
    """Full scales from the CAN frames, the inertial unit's layout and the scanner's range."""
    pressure = drivers.frames.by_name[PRESSURES].get_signal_by_name("supply_pressure").maximum
    inertial = {channel.name: channel.full_scale for channel in drivers.layout.channels}
    return FullScales(
        pressure=float(pressure or 0.0),
        acceleration=inertial["XA"] * GRAVITY,
        rate=math.radians(inertial["XR"]),
        field=inertial.get("XM", 0.0) * TESLA_PER_MILLIGAUSS,
        range=drivers.sick.range_max,
    )
