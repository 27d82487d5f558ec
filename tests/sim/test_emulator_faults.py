# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of the emulated excavator: refused settings, and the effect of each fault in simulated time."""

import itertools
from functools import cache

import numpy as np
import pytest

from trackslip_common.errors import InputError
from trackslip_drivers.protocols.can_errors import BusState, bus_state
from trackslip_drivers.protocols.can_frames import ERROR_FLAG
from trackslip_sim.devices.pty_port import PtyPort
from trackslip_sim.machine.excavator import EmulatedExcavator, simulate_drive
from trackslip_sim.machine.faults import Fault, parse_fault
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_sim.scenarios.scenario import parse_scenario

MS, S = 1_000_000, 1_000_000_000
PARAMETERS = load_emulator_parameters(
    {"scenario": "straight", "mode": "thesis", "duration": 30.0, "lead_in": 0.0}
)
TRUTH = simulate_drive(PARAMETERS)
GOOD = {"sensor": "sick", "kind": "glare", "start": 1.0, "duration": 2.0, "value": 0.5}


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"sensor": "sonar"}, "'sonar' has no glare; accepted: sick"),
        ({"kind": "fire"}, "'fire' is unknown; accepted: power_cycle"),
        ({"kind": "bus_off", "value": 0.0}, "'sick' has no bus_off; accepted: can"),
        ({"duration": 0.0}, "duration = 0.0 is refused; accepted: > 0"),
        ({"duration": 1e9}, "duration"),
        ({"value": 0.0}, "accepted for glare: > 0 and <= 1 (share of the rays"),
        ({"value": 1.5}, "value = 1.5"),
        ({"kind": "unplug"}, "accepted: none for unplug"),
    ],
)
def test_each_mistake_is_named_in_one_line(change, named):
    with pytest.raises(InputError, match=r"^fault: ") as refused:
        Fault(**(GOOD | change))
    assert named in str(refused.value)
    assert "\n" not in str(refused.value)


def test_text_and_scenario_hold_the_same_record():
    assert parse_fault("{sensor: can, kind: stuck, duration: 2}", 7.5) == Fault("can", "stuck", 7.5, 2.0)
    tree = {"name": "x", "soil": "sand", "segments": [{"duration": 1, "left": 1, "right": 1}]}
    assert parse_scenario(tree | {"faults": [GOOD]}).faults == (Fault(**GOOD),)
    with pytest.raises(InputError, match=r"faults\[1\]: fault: key 'duration' is missing"):
        parse_scenario(tree | {"faults": [GOOD, {"sensor": "can", "kind": "stuck", "start": 1}]})


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("{sensor: sick, kind: unplug, start: 2026-13-45, duration: 1}", "not YAML"),
        ("{sensor: sick, kind: unplug, start: 1e400, duration: 1}", "start: inf"),
        ("{sensor: [sick], kind: {a: b}, duration: 1}", "sensor: ['sick']"),
        ("{sensor: sick, kind: unplug, duration: 3.1,5}", "unknown key '5'"),
        ('{sensor: "\\e[2J", kind: unplug, duration: 1}', "has no unplug"),
        ("[1]", "accepted: a mapping"),
    ],
)
def test_hostile_text_of_a_fault_is_refused_for_its_defect_in_one_line(text, reason):
    with pytest.raises(InputError) as refused:
        parse_fault(text, 0.0)
    assert reason in str(refused.value)
    assert str(refused.value).isprintable()


@cache
def run(*faults, seconds=12.0):
    """Output of the machine: (ns, frames, bytes of the inertial unit)."""
    excavator = EmulatedExcavator(PARAMETERS, TRUTH, 0)
    for fault in faults:
        excavator.faults.add(fault, 0)
    sent = []
    for now in range(0, round(seconds * S), 2 * MS):
        sent.append((now, excavator.step_can(now), excavator.step_watson(now)))
    return sent


def between(sent, start, stop, column):
    """The non-empty entries of one column in [start, stop) s."""
    return [row[column] for row in sent if start * S <= row[0] < stop * S and row[column]]


def frames_between(sent, start, stop):
    return list(itertools.chain.from_iterable(between(sent, start, stop, 1)))


def test_power_cycle_silences_and_boots():
    sent = run(*(Fault(sensor, "power_cycle", 6.0, 0.5) for sensor in ("can", "watson")), seconds=13.0)
    for column in (1, 2):
        assert between(sent, 5.5, 5.9, column)
        assert not between(sent, 6.0, 6.498, column)
    assert not between(sent, 6.5, 7.498, 1)
    assert between(sent, 7.498, 7.52, 1)  # 1 s of boot
    assert b"WATSON" in b"".join(between(sent, 6.5, 7.0, 2))
    assert not between(sent, 7.0, 11.49, 2)
    assert b"R " in b"".join(between(sent, 11.5, 12.0, 2))  # 5 s of initialisation


def test_bus_off_is_reported_and_so_is_the_restart():
    sent = run(Fault("can", "bus_off", 2.0, 1.0), seconds=4.0)
    (off,) = frames_between(sent, 2.0, 3.0)
    assert off[0] & ERROR_FLAG
    assert bus_state(*off) is BusState.OFF
    back = between(sent, 3.0, 3.02, 1)[0][0]
    assert bus_state(*back) is BusState.ACTIVE
    assert len(frames_between(sent, 3.0, 4.0)) == pytest.approx(301, abs=3)


def test_frames_and_bytes_are_lost_at_the_requested_rate():
    sent = run(
        Fault("can", "lost_frames", 2.0, 4.0, 0.25),
        Fault("watson", "lost_bytes", 6.0, 5.0, 0.1),
        Fault("can", "unplug", 7.0, 1.0),
    )
    good = run()
    assert len(frames_between(sent, 2.0, 6.0)) == pytest.approx(0.75 * 1200, rel=0.1)
    assert not between(sent, 7.0, 8.0, 1)
    bytes_of = [len(b"".join(between(which, 6.0, 11.0, 2))) for which in (sent, good)]
    assert bytes_of[0] == pytest.approx(0.9 * bytes_of[1], rel=0.03)


def test_unplugged_line_transmits_nothing(monkeypatch):
    """Also in a recorded drive, which has no ports to remove."""
    sent = run(Fault("watson", "unplug", 6.0, 2.0))
    assert [bool(between(sent, at, at + 1.0, 2)) for at in (5.0, 6.0, 7.0, 8.0)] == [True, False, False, True]
    received = []
    excavator = EmulatedExcavator(PARAMETERS, TRUTH, 0)
    monkeypatch.setattr(excavator.sick, "receive", lambda *sent: received.append(sent))
    excavator.faults.add(Fault("sick", "unplug", 6.0, 2.0), 0)
    for at_s in (5.0, 7.0, 9.0):
        excavator.receive_sick(b"?", round(at_s * S), 9600)
    assert [now_ns / S for _, now_ns, _ in received] == [5.0, 9.0]


@pytest.mark.parametrize(
    ("kind", "value"), [("doubled_bytes", 0.1), ("corrupted_bytes", 0.1), ("wrong_baud", 0.0)]
)
def test_bytes_change(kind, value):
    bad = b"".join(between(run(Fault("watson", kind, 6.0, 5.0, value)), 6.0, 11.0, 2))
    good = b"".join(between(run(), 6.0, 11.0, 2))
    if kind == "doubled_bytes":
        assert len(bad) == pytest.approx(1.1 * len(good), rel=0.03)
        return
    assert len(bad) == len(good)
    changed = np.mean(np.frombuffer(bad, np.uint8) != np.frombuffer(good, np.uint8))
    assert changed == pytest.approx(value or 255 / 256, rel=0.15)


def test_bursts_lose_no_data():
    bursts = run(Fault("can", "bursts", 2.0, 3.0, 0.5), Fault("watson", "bursts", 6.0, 2.0, 0.5))
    good = run()
    assert len(between(bursts, 2.0, 5.0, 1)) == 5  # at 2.5, 3.0 … 4.5 s
    assert frames_between(bursts, 0.0, 12.0) == frames_between(good, 0.0, 12.0)
    assert b"".join(between(bursts, 0.0, 12.0, 2)) == b"".join(between(good, 0.0, 12.0, 2))
    assert len(between(bursts, 6.0, 8.0, 2)) <= 5


def readings(*faults):
    excavator = EmulatedExcavator(PARAMETERS, TRUTH, 0)
    for fault in faults:
        excavator.faults.add(fault, 0)
    return excavator._readings


def test_stuck_fault_holds_the_reading_for_its_duration():
    stuck = readings(Fault("can", "stuck", 5.0, 2.0))
    positions = [stuck.sprockets(round(t * S)).left_position for t in (4.9, 5.0, 6.9, 7.1)]
    assert positions[1] == positions[2]
    assert positions[0] < positions[1] < positions[3]


def test_noise_is_a_share_of_full_scale():
    noisy, quiet = readings(Fault("watson", "noise", 0.0, 20.0, 0.01)), readings()
    stddevs = [
        np.std([which.imu(k * S // 100).angular_velocity[0] for k in range(1000)]) for which in (noisy, quiet)
    ]
    assert stddevs[0] == pytest.approx(np.radians(2.0), rel=0.1)  # at 200 °/s
    assert stddevs[1] == pytest.approx(PARAMETERS.noise.gyro_stddev, rel=0.1)
    loud = readings(Fault("can", "noise", 0.0, 20.0, 0.1))
    supply = [loud.hydraulics(k * S // 100).supply_pressure for k in range(1000)]
    assert np.std(np.diff(supply)) / np.sqrt(2.0) == pytest.approx(2.5e6, rel=0.1)


def test_faults_of_the_scanner():
    bad = readings(
        Fault("sick", "occlusion", 0.0, 5.0, 0.5),
        Fault("sick", "glare", 10.0, 5.0, 0.3),
        Fault("sick", "pollution", 10.0, 5.0),
        Fault("sick", "noise", 20.0, 5.0, 0.02),
    )
    angles = np.radians(np.arange(361) / 2 - 90)
    covered = np.abs(angles) <= 0.25
    assert (bad.ranges(S)[covered] <= 0.5).all()
    assert (bad.ranges(S)[~covered] > 0.5).all()
    assert np.isnan(bad.ranges(11 * S)).mean() == pytest.approx(0.3, abs=0.1)
    assert (bad.status(S), bad.status(11 * S)) == (0, 0x80)
    noisy, plain = bad.ranges(21 * S), readings().ranges(21 * S)
    is_hit = np.isfinite(plain)
    assert np.std(noisy[is_hit] - plain[is_hit]) == pytest.approx(1.0, rel=0.2)  # at 50 m


def test_port_comes_back_under_its_name(tmp_path):
    port = PtyPort(tmp_path / "device")
    port.close()
    assert not port.link.exists()
    assert (port.write(b"lost"), port.read(), port.baud) == (0, b"", None)
    assert port.bytes_lost == 4
    port.plug()
    assert port.link.exists()
    port.close()
    port.close()


@pytest.mark.parametrize("kind", ["a file", "a link to a file", "a directory"])
def test_file_of_the_user_is_not_replaced_by_a_port(tmp_path, kind):
    """``device_directory`` contains a file with the name of a port."""
    mine, named = tmp_path / "mine", tmp_path / "watson"
    mine.write_text("years of work", encoding="utf-8")
    {
        "a file": lambda: mine.rename(named),
        "a link to a file": lambda: named.symlink_to(mine),
        "a directory": named.mkdir,
    }[kind]()
    before = sorted((path.name, path.is_symlink()) for path in tmp_path.iterdir())
    with pytest.raises(InputError, match=r"watson' is no port of an emulator, and is not replaced"):
        PtyPort(named)
    assert sorted((path.name, path.is_symlink()) for path in tmp_path.iterdir()) == before
