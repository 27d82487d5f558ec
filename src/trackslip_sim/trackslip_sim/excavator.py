# SPDX-License-Identifier: Apache-2.0
"""The emulated excavator: one true drive behind three devices that speak bytes. No port, no clock."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from trackslip_common.config_files import config_file, node_defaults
from trackslip_common.parameters import Parameters, from_flat
from trackslip_drivers.can_parameters import CanDriverParameters
from trackslip_drivers.protocols.can_frames import ENCODERS, PRESSURES, FrameSet
from trackslip_drivers.protocols.watson import BITS_PER_CHAR, Layout
from trackslip_drivers.sick_parameters import SickParameters
from trackslip_drivers.watson_parameters import WatsonParameters
from trackslip_sim.devices.can_device import CanDevice
from trackslip_sim.devices.line import BaudLine
from trackslip_sim.devices.sick_device import SickDevice
from trackslip_sim.devices.watson_device import WatsonDevice
from trackslip_sim.parameters import EmulatorParameters
from trackslip_sim.scan_model import SiteScanner
from trackslip_sim.scenarios import load_scenario
from trackslip_sim.sensors import MachineSensors
from trackslip_sim.truth.record import Truth
from trackslip_sim.truth.simulate import simulate

FloatArray = NDArray[np.float64]
T = TypeVar("T", bound=Parameters)


def drive(p: EmulatorParameters) -> Truth:
    """The true motion that the parameters ask for.

    Raises:
        InputError: scenario or soil is unknown, or refused.
    """
    scenario = load_scenario(p.scenario)
    if p.duration > 0.0:
        scenario = scenario.stretched(p.duration)
    return simulate(scenario, soil=p.soil or None, mode=p.mode, vehicle=p.vehicle)


class EmulatedExcavator:
    """Devices from power-on at ``start_ns``; they measure ``truth`` from ``drive_start_ns`` on.

    Each device is set up as its driver's defaults in ``config/`` expect it.
    """

    def __init__(self, p: EmulatorParameters, truth: Truth, start_ns: int) -> None:
        self.drive_start_ns = start_ns + round(p.lead_in * 1e9)
        self.end_ns = self.drive_start_ns + round(truth.duration * 1e9)
        self.sensors = MachineSensors(truth, p.noise, self.drive_start_ns, p.seed)
        can = _defaults(CanDriverParameters, "can_driver")
        self.can = CanDevice(
            FrameSet(config_file(can.dbc_file)),
            can.belt_ratio,
            self.sensors.sprockets,
            self.sensors.hydraulics,
            start_ns + round(p.can_delay * 1e9),
        )
        watson = _defaults(WatsonParameters, "watson_imu")
        layout = Layout(watson.channels, watson.formats, watson.full_scales)
        self._watson_line = BaudLine(watson.serial_baud, BITS_PER_CHAR)
        self.watson = WatsonDevice(layout, self._watson_line, self.sensors.imu, True, start_ns)
        self._scanner = SiteScanner(p.site, p.vehicle, p.seed)
        self.sick = SickDevice(_defaults(SickParameters, "sick_pls"), p.sick_start, self._scan, start_ns)

    def step_can(self, now_ns: int) -> list[tuple[int, bytes]]:
        """Frames due by now."""
        return self.can.step(min(now_ns, self.end_ns))

    def step_watson(self, now_ns: int) -> bytes:
        """Characters that have left by now; the last line drains after the end."""
        if now_ns < self.end_ns:
            return self.watson.step(now_ns)
        return self._watson_line.take(now_ns)

    def step_sick(self, now_ns: int) -> bytes:
        """Characters that have left by now."""
        return self.sick.step(now_ns) if now_ns < self.end_ns else b""

    def emitted(self) -> dict[str, int]:
        """How many messages of each sensor topic the bytes sent so far hold."""
        frames, lines = self.can.frames_emitted, self.watson.lines_emitted
        return {
            "sprockets": frames[ENCODERS],
            "hydraulics": frames[PRESSURES],
            "imu/data_raw": lines,
            "imu/mag": lines,
            "scan": self.sick.scans_emitted,
        }

    def _scan(self, stamp_ns: int) -> FloatArray:
        return self._scanner.scan(self.sensors.time(stamp_ns), self.sensors.pose_at)


def _defaults(cls: type[T], node: str) -> T:
    """A driver's own default parameters."""
    return from_flat(cls, node_defaults(node, f"{node}.yaml"), node)
