# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Each driver's executable with an emulated device: bytes in, messages of the right type out."""

import itertools
import math
import os
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from fixtures.observer import last_of, last_values, values_of
from fixtures.own_node import started
from fixtures.patience import wait_for
from fixtures.plugged_devices import (
    FIELD,
    RATE,
    SPEED,
    G,
    Powered,
    plug_can,
    plug_incomplete,
    plug_sick,
    plug_watson,
    yard,
)

from trackslip_common.make import stamp_ns_of
from trackslip_drivers.nodes.sick_pls import SickNode
from trackslip_drivers.protocols.sick_session import Phase


@pytest.fixture
def device():
    """Factory of powered devices; they are unplugged at the end."""
    devices = []

    def make(plug_in, *arguments):
        devices.append(Powered(partial(plug_in, *arguments)))
        return devices[-1]

    yield make
    for powered in devices:
        powered.unplug()


@pytest.fixture
def bench(real_time, programs, device, can, udp_port):
    """Device and parameters of each driver, by name."""
    serial = str(programs.folder / "tty")
    return {
        "watson_imu": (partial(device, plug_watson, programs.folder / "tty"), {"serial_port": serial}),
        "sick_pls": (partial(device, plug_sick, programs.folder / "tty"), {"serial_port": serial}),
        "can_driver": (partial(device, plug_can, udp_port), can),
    }


SHORTEST_SILENCE = 0.05  # s; the CAN driver may report a longer silence
TOPIC = {"watson_imu": "imu/data_raw", "sick_pls": "scan", "can_driver": "sprockets"}


def assert_stamped(messages, began_ns):
    """Assert that stamps rise strictly and lie between the start of the test and now."""
    stamps = [stamp_ns_of(message) for message in messages]
    assert all(a < b for a, b in itertools.pairwise(stamps))
    assert began_ns - 500_000_000 < stamps[0]
    assert stamps[-1] <= time.time_ns()


def is_healthy(healths, node):
    """Whether the node's last report is OK, with a positive rate and no reconnects."""
    if getattr(last_of(healths, node), "level", None) != b"\0":
        return False
    values = last_values(healths, node)
    return float(values["rate (Hz)"]) > 0.0 and values["reconnects"] == "0"


def run(bench, programs, observer, node, count):
    """Plug the device in, start its driver, and wait for messages and an OK report; the messages."""
    make, parameters = bench[node]
    began_ns = time.time_ns()
    powered = make()
    powered.plug()
    messages, healths = observer.subscribe(TOPIC[node]), observer.healths()
    program = programs.node(node, **parameters)
    observer.wait(lambda: len(messages) >= count, f"{count} messages of {node}: {program.stderr}")
    observer.wait(lambda: is_healthy(healths, node), f"good health of {node}")
    assert_stamped(messages, began_ns)
    code, _ = program.end()
    assert code == 0
    faults = [line for line in program.stderr.splitlines() if "[ERROR]" in line or "Traceback" in line]
    if powered.longest_halt_s > SHORTEST_SILENCE:  # then the driver rightly reports a silence
        faults = [line for line in faults if "check power" not in line]
    assert faults == []  # the driver logs its changes of state
    return messages


def test_watson(bench, programs, observer):
    fields = observer.subscribe("imu/mag")
    for message in run(bench, programs, observer, "watson_imu", 20):
        assert message.header.frame_id == "imu_link"
        assert message.orientation_covariance[0] == -1.0
        acceleration, rate = message.linear_acceleration, message.angular_velocity
        assert (acceleration.x, acceleration.y) == (0.0, 0.0)
        assert acceleration.z == pytest.approx(G, abs=0.01)  # z up: at rest the reading is +g
        assert rate.z == pytest.approx(RATE, abs=math.radians(0.01))
        for covariance in (message.linear_acceleration_covariance, message.angular_velocity_covariance):
            covariance = np.reshape(covariance, (3, 3))
            assert np.count_nonzero(covariance) == 3
            assert (np.diag(covariance) > 0.0).all()
    assert fields[0].header.frame_id == "imu_link"
    magnetic = fields[0].magnetic_field
    assert (magnetic.x, magnetic.y, magnetic.z) == pytest.approx(FIELD, abs=1e-7)


def test_sick(bench, programs, observer):
    for message in run(bench, programs, observer, "sick_pls", 5):
        assert message.header.frame_id == "laser"
        assert len(message.ranges) == 361
        assert message.angle_min == pytest.approx(-math.pi / 2.0)
        assert message.angle_max == pytest.approx(math.pi / 2.0)
        assert message.angle_min + 360 * message.angle_increment == pytest.approx(message.angle_max, abs=1e-5)
        assert message.angle_increment > 0.0  # counter-clockwise
        assert message.scan_time == pytest.approx(0.04)
        assert 0.0 < message.time_increment * 361 < message.scan_time
        ranges = np.array(message.ranges)
        np.testing.assert_allclose(ranges[:340], yard(0)[:340], atol=0.005)
        assert np.isposinf(ranges[340:]).all()  # REP-117: no return within range
        inside = ranges[np.isfinite(ranges)]
        assert ((inside >= message.range_min) & (inside <= message.range_max)).all()


def test_refused_password_is_reported(programs, observer, device):
    device(plug_sick, programs.folder / "tty", "lms").plug()
    healths = observer.healths()
    programs.node("sick_pls", serial_port=str(programs.folder / "tty"))
    observer.wait(
        lambda: any(h.name == "sick_pls: password" and h.level == b"\x02" for h in healths), "its refusal"
    )
    assert last_values(healths, "sick_pls")["scan: password refused"] == "1"


class ReopenedSick(SickNode):
    """Its port is opened again while it stops the scanner."""

    was_reopened = False

    def _step_dialogue(self):
        if self._session.phase is Phase.STOPPING and not self.was_reopened:
            self.was_reopened = True
            self.restart_decoding()
        super()._step_dialogue()


def test_scanner_is_stopped_though_its_port_reopens_during_deactivation(domain, tmp_path):
    with started(ReopenedSick, domain, serial_port=str(tmp_path / "tty")) as node:
        pass
    assert node.was_reopened
    assert node._session.phase is Phase.STOPPED


def test_silent_scanner_is_not_reported_as_running_while_its_rate_is_looked_for(domain, tmp_path):
    with started(SickNode, domain, serial_port=str(tmp_path / "tty")) as node:
        period = node.period
        wait_for(lambda: node._session.baud == 9600)
        assert node.period == period


def test_the_status_of_the_scanner_is_reported(programs, observer, device):
    """Fatal error, implausible values, restart, pollution and dazzle are reported until they end."""
    path = programs.folder / "tty"
    status = {"byte": 0xE4, "dazzled": True}
    device(plug_sick, path, "pls", status).plug()
    healths = observer.healths()
    programs.node("sick_pls", serial_port=str(path))
    parts = {"status": b"\2", "implausible": b"\2", "restart": b"\1", "pollution": b"\1", "rays": b"\1"}

    def levels():
        last = [h for h in healths if h.name == "sick_pls"][-1:]
        return {h.name.partition(": ")[2]: h.level for h in healths[healths.index(last[0]) :]} if last else {}

    observer.wait(lambda: parts.items() <= levels().items(), "all of its status")
    fatal = last_of(healths, "sick_pls: status")
    assert fatal.message == "scanner reports: fatal"
    assert fatal.hardware_id == str(path)
    status.update(byte=0, dazzled=False)
    observer.wait(lambda: levels() and not parts.keys() & levels().keys(), "nothing more")


def test_watson_over_range_is_reported(programs, observer, device):
    path = programs.folder / "tty"
    device(plug_watson, path, True).plug()
    healths = observer.healths()
    programs.node("watson_imu", serial_port=str(path))
    observer.wait(
        lambda: any(h.name == "watson_imu: range" and h.level == b"\1" for h in healths), "the warning"
    )


def test_can(bench, programs, observer):
    hydraulics = observer.subscribe("hydraulics")
    messages = run(bench, programs, observer, "can_driver", 200)
    for message in messages:
        assert message.header.frame_id == "base_link"
        assert list(message.name) == ["left_sprocket", "right_sprocket"]
        assert len(message.effort) == 0
    last = messages[-50:]
    assert np.mean([m.velocity for m in last], axis=0) == pytest.approx(SPEED, abs=0.02)
    turned = np.subtract(last[-1].position, last[0].position)
    seconds = (stamp_ns_of(last[-1]) - stamp_ns_of(last[0])) * 1e-9
    assert turned / seconds == pytest.approx(SPEED, abs=0.1)
    for message in hydraulics:
        assert message.header.frame_id == "base_link"
        assert (message.left_pressure, message.right_pressure) == pytest.approx((4.0e6, -2.0e6), rel=0.01)
        assert (message.left_spool, message.right_spool) == pytest.approx((0.5, -0.25), abs=0.01)
        assert message.supply_pressure == pytest.approx(18.0e6, rel=0.01)
    assert_stamped(hydraulics, stamp_ns_of(messages[0]))


def test_briefly_unusable_frames_are_no_fault(bench, programs, observer, device, udp_port):
    """After a pause, counts jump and one frame waits for another."""
    device(plug_incomplete, udp_port).plug()
    messages = observer.subscribe(TOPIC["can_driver"])
    program = programs.node("can_driver", **bench["can_driver"][1])
    observer.wait(lambda: len(messages) >= 150, f"messages between pauses: {program.stderr}")
    program.end()
    assert "none is usable" not in "".join(line for line in program.stderr.splitlines() if "[ERROR]" in line)


@pytest.mark.parametrize(
    "node", ["watson_imu", "can_driver", pytest.param("sick_pls", marks=pytest.mark.slow)]
)
def test_device_that_vanishes_is_found_again(bench, programs, observer, node):
    make, parameters = bench[node]
    powered = make()
    messages, healths = observer.subscribe(TOPIC[node]), observer.healths()
    program = programs.node(node, **parameters)  # before the device exists
    observer.wait(lambda: any(h.name == node for h in healths), f"the first report of {node}")
    powered.plug()
    observer.wait(lambda: messages, f"{node} to find its device")
    powered.unplug()
    healths.clear()
    observer.wait(lambda: any(is_known_missing(h) for h in healths if h.name == node), f"{node} to complain")
    observer.wait(lambda: has_complaint(program.stderr), f"a line of {node} about it")
    messages.clear()
    powered.plug()
    observer.wait(lambda: messages, f"{node} to find its device again")
    assert program.process.poll() is None
    observer.wait(lambda: any(reconnects(h) > 0 for h in healths if h.name == node), "a count of reconnects")
    code, _ = program.end()
    assert code == 0
    assert "Traceback" not in program.stderr


def has_complaint(console):
    """Whether the console reports a missing device and the remedy."""
    reports = [line for line in console.splitlines() if "check power" in line]
    return any("not connected" in line or "no bytes" in line or "no frames" in line for line in reports)


def is_known_missing(status):
    """Whether the device is known to be missing; a silent bus is reopened."""
    return status.level == b"\x02" or reconnects(status) > 0


def reconnects(status):
    return int(values_of(status).get("reconnects", 0))


@pytest.mark.parametrize(
    "node", ["sick_pls", *(pytest.param(n, marks=pytest.mark.slow) for n in ("watson_imu", "can_driver"))]
)
def test_lifecycle(bench, programs, observer, node):
    make, parameters = bench[node]
    make().plug()
    messages, healths = observer.subscribe(TOPIC[node]), observer.healths()
    program = programs.node(node, autostart=False, **parameters)
    observer.wait(lambda: any(h.name == node for h in healths), f"the first report of {node}")
    assert observer.state(node) == "unconfigured"
    assert not observer.change(node, "activate")
    assert observer.change(node, "configure")
    assert observer.state(node) == "inactive"
    assert not messages
    for _ in range(2):
        assert observer.change(node, "activate")
        assert observer.state(node) == "active"
        messages.clear()  # messages in transit
        observer.wait(lambda: len(messages) > 2, f"messages of active {node}")
        assert observer.change(node, "deactivate")
        assert observer.state(node) == "inactive"
    for what in ("to rest", "to rest on"):
        messages.clear()
        healths.clear()
        observer.wait(lambda: any(h.message == "inactive" for h in healths), f"{node} {what}")
    assert messages == []
    assert observer.change(node, "cleanup")
    assert observer.state(node) == "unconfigured"
    observer.wait(lambda: observer.node.count_publishers(TOPIC[node]) == 0, "the topic to go")
    assert observer.change(node, "configure")
    assert observer.change(node, "activate")
    observer.wait(lambda: messages, f"messages of {node} after its cleanup")
    code, _ = program.end()
    assert code == 0
    assert "Traceback" not in program.stderr


@pytest.mark.parametrize("priority", [7, pytest.param(0, marks=pytest.mark.slow)])
def test_realtime_priority(bench, programs, observer, priority):
    """All threads of the process have the priority, or the node reports that the host refuses it."""
    program = programs.node("can_driver", **bench["can_driver"][1], realtime_priority=priority)
    observer.wait_until_active("can_driver")
    threads = [int(path.name) for path in Path(f"/proc/{program.process.pid}/task").iterdir()]

    def settled():
        policies = {(os.sched_getscheduler(t), os.sched_getparam(t).sched_priority) for t in threads}
        return policies == {(os.SCHED_FIFO if priority else os.SCHED_OTHER, priority)}

    program.until(lambda: settled() or "no right to real-time" in program.stderr, "the scheduler")
    assert priority or settled()
