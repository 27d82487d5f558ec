# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The three emulated devices at their full rates, as a process: ``bench_devices.py DIRECTORY PORT``.

CAN 100 Hz × 3 frames on UDP multicast; Watson binary frames at 71 Hz and scans at 25 Hz on ptys in DIRECTORY.
Runs until interrupted.
"""

import math
import sys
import time
from pathlib import Path

import numpy as np

from trackslip_common.config_files import node_defaults
from trackslip_common.units import GRAVITY
from trackslip_drivers.protocols.watson import BINARY, BITS_PER_CHAR, COMMAND_MODE
from trackslip_drivers.records import HydraulicsSample, ImuSample, SprocketSample
from trackslip_drivers.transports.can_bus import CanBus
from trackslip_sim.devices.can_device import CanDevice
from trackslip_sim.devices.line import BaudLine
from trackslip_sim.devices.pty_port import PtyPort
from trackslip_sim.devices.sick_device import SickDevice, SickDeviceParameters
from trackslip_sim.devices.watson_device import WatsonDevice
from trackslip_sim.machine.driver_settings import default_drivers

WATSON_BAUD = 19_200  # the lowest rate that carries nine channels 71 times a second
SICK_BAUD = 500_000
_TICK = 0.002  # s, as in the emulator


def sprockets(stamp_ns: int) -> SprocketSample:
    """Sample of both sprockets at 1 rad/s."""
    position = stamp_ns * 1e-9 % (2.0 * math.pi)
    return SprocketSample(stamp_ns, position, position, 1.0, 1.0)


def hydraulics(stamp_ns: int) -> HydraulicsSample:
    return HydraulicsSample(stamp_ns, 5e6, 4e6, 0.5, 0.4, 1e7)


def imu(stamp_ns: int) -> ImuSample:
    return ImuSample(stamp_ns, (0.0, 0.0, GRAVITY), (0.0, 0.0, 0.1), (2e-5, 0.0, 5e-5), over_range=False)


def main(directory: Path, can_port: int) -> None:
    """Run the devices."""
    now_ns = time.time_ns()
    drivers = default_drivers()
    machine = CanDevice(drivers.frames, sprockets, hydraulics, now_ns)
    line = node_defaults("emulator", "emulator.yaml")
    bus = CanBus(line["can_interface"], line["can_channel"], {"port": can_port})
    watson = WatsonDevice(drivers.layout, BaudLine(WATSON_BAUD, BITS_PER_CHAR), imu, True, now_ns)
    watson.receive(COMMAND_MODE + BINARY, now_ns)
    ranges = np.random.default_rng(1).uniform(2.0, 40.0, 361)
    boot = SickDeviceParameters(boot_delay=0.0, power_on_baud=9600)
    sick = SickDevice(drivers.sick, boot, lambda _: ranges, now_ns)
    watson_port, sick_port = PtyPort(directory / "watson"), PtyPort(directory / "sick")
    while True:
        now_ns = time.time_ns()
        for frame in machine.step(now_ns):
            bus.write(frame)
        watson_port.read()
        watson_port.write(watson.step(now_ns))
        sick.receive(sick_port.read(), now_ns, sick_port.baud)
        sent = sick.step(now_ns)
        if sick_port.baud == sick.baud:
            sick_port.write(sent)
        time.sleep(_TICK)


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]), int(sys.argv[2]))
    except KeyboardInterrupt:
        sys.exit(130)
