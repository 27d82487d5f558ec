# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The drivers against an emulator with faults on demand: each fault is reported and ends without a trace."""

import random
import re
from pathlib import Path

import pytest
from fixtures.observer import values_of
from std_msgs.msg import String

from trackslip_sim.machine.faults import KINDS, SENSORS

pytestmark = pytest.mark.xdist_group("graph")

NODE = {"can": "can_driver", "watson": "watson_imu", "sick": "sick_pls", "gnss": "nmea_gnss"}
RATE = {"can": 100.0, "watson": 11.85, "sick": 1 / 0.24, "gnss": 10.0}  # Hz
OK, WARN = b"\0", b"\1"
SILENCES = "scan: scans stopped coming"
LONG = 1500.0  # s of driving: longer than any test

VALUES = {  # of random faults
    **dict.fromkeys(("lost_bytes", "doubled_bytes", "corrupted_bytes"), 0.01),
    "lost_frames": 0.1,
    "bursts": 0.3,
    "noise": 0.05,
    "occlusion": 0.5,
    "glare": 0.3,
    "multipath": 2.0,
    "clock_step": 18.0,
}


class Rig:
    """Emulator and drivers, observed through diagnostics."""

    def __init__(self, programs, observer, can, sensors=tuple(NODE)):
        devices = programs.folder / "devices"
        drive = {"scenario": "straight", "duration": LONG, "mode": "thesis", "gnss.device.rate": 10.0}
        self._observer, self._sensors = observer, sensors
        self._fault = observer.publisher("emulator/fault")
        self._healths = {}
        self._all = observer.healths()
        self.programs = {"emulator": programs.node("emulator", device_directory=str(devices), **drive, **can)}
        for sensor in sensors:
            ports = can if sensor == "can" else {"serial_port": str(devices / sensor)}
            self.programs[NODE[sensor]] = programs.node(NODE[sensor], **ports)
        if "gnss" in sensors:
            self.programs["gnss_localizer"] = programs.node("gnss_localizer")
        observer.wait_for_ends("emulator/fault", "emulator")
        self.wait_until_nominal()

    def wait(self, condition, what):
        self._observer.wait(condition, what)

    def latest(self, name):
        """Last report of a node or of a part of it: (level, values)."""
        for status in self._all:
            self._healths[status.name] = status
        self._all.clear()
        status = self._healths.get(name)
        return None if status is None else (status.level, values_of(status))

    def value(self, name, key):
        report = self.latest(name)
        return None if report is None else report[1].get(key)

    def count(self, name, key):
        """A count in a node's report; it also shows events that end before the next report."""
        return int(self.value(name, key) or 0)

    def fault(self, text):
        self._fault.publish(String(data="{" + text + "}"))

    def is_data_missing(self, sensor):
        """Whether the driver reports missing data."""
        report = self.latest(NODE[sensor])
        return report is not None and report[0] not in (OK, WARN)

    def is_ok(self, name):
        report = self.latest(name)
        return report is not None and report[0] == OK

    def is_nominal(self, sensor):
        return (
            self.is_ok(NODE[sensor])
            and float(self.value(NODE[sensor], "rate (Hz)")) == pytest.approx(RATE[sensor], rel=0.3)
            and (sensor != "gnss" or self.is_ok("gnss_localizer"))
        )

    def wait_until_nominal(self):
        for sensor in self._sensors:
            self.wait(lambda s=sensor: self.is_nominal(s), f"{sensor} to be well")

    def memory(self):
        """Resident memory of each node except the emulator, kB."""
        nodes = self.programs.keys() - {"emulator"}
        return {name: resident(self.programs[name].process.pid) for name in nodes}


def resident(pid):
    return int(re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{pid}/status").read_text())[1])


@pytest.fixture
def rig(real_time, programs, observer, can):
    return Rig(programs, observer, can)


def test_sensors_fail_and_come_back_and_malformed_faults_are_refused(rig):
    for sensor in NODE:
        rig.fault(f"sensor: {sensor}, kind: unplug, duration: 4.0")
    missed = set()

    def all_missed():
        missed.update(filter(rig.is_data_missing, NODE))
        return missed == set(NODE)

    rig.wait(all_missed, "all to be missed")
    rig.fault("sensor: sick, kind: pollution, duration: 600.0")
    rig.wait_until_nominal()
    rig.wait(lambda: rig.latest("sick_pls: pollution"), "the dirt to be seen")
    rig.fault("sensor: can, kind: bus_off, duration: 0.5")
    rig.wait(lambda: rig.count("can_driver", "can: error frame") >= 1, "the bus to be missed")
    rig.wait_until_nominal()
    silences = rig.count("sick_pls", SILENCES)
    rig.fault("sensor: sick, kind: power_cycle, duration: 0.3")
    rig.wait(lambda: rig.count("sick_pls", SILENCES) > silences, "the scanner to be missed")
    rig.wait_until_nominal()
    assert rig.value("can_driver", "bus state") == "active"
    assert rig.count("watson_imu", "reconnects") >= 1
    for text in ("sensor: can", "sensor: can, kind: bus_off, duration: -1", "sensor: sonar, kind: stuck"):
        rig.fault(text)
    rig.wait(lambda: rig.value("emulator", "faults refused") == "3", "three refusals to be counted")


@pytest.mark.soak
@pytest.mark.timeout(1500)
@pytest.mark.parametrize("failing", [SENSORS, ("gnss",)], ids=["of all sensors", "of the receiver"])
def test_a_hundred_faults_in_a_row(programs, observer, can, failing):
    """No node ends, leaks memory or stays below its nominal rate."""
    rig, choose = Rig(programs, observer, can, failing), random.Random(1)
    kinds = {name: sorted({*kind.sensors} & {*failing}) for name, kind in KINDS.items()}
    before = None
    for n in range(100):
        kind = choose.choice(sorted(kind for kind, sensors in kinds.items() if sensors))
        sensor, duration = choose.choice(kinds[kind]), choose.uniform(0.2, 3.0)
        extra = f", value: {VALUES[kind]}" if kind in VALUES else ""
        rig.fault(f"sensor: {sensor}, kind: {kind}, duration: {duration:.2f}{extra}")
        this = f"fault {n}: {sensor} {kind}"
        rig.wait(lambda n=n: rig.value("emulator", "faults accepted") == str(n + 1), this)
        rig.wait(lambda: rig.value("emulator", "faults") == "none", f"the end of {this}")
        rig.wait_until_nominal()
        if n == 9:  # one-time allocations are done by now
            before = rig.memory()
    growth = {name: kilobytes - before[name] for name, kilobytes in rig.memory().items()}
    print(growth)
    assert max(growth.values()) < 5000, growth
