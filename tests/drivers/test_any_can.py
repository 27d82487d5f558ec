# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""CAN buses that a DBC and a roles file alone describe are decoded; invalid files are refused in one line."""

import dataclasses
import math
from collections import defaultdict

import can
import cantools
import numpy as np
import pytest
from fixtures import unseen_bus
from fixtures.excavator_bus import PARAMETERS
from fixtures.unseen_bus import drive, machine, refusal

from trackslip_bags.messages import make
from trackslip_common.errors import InputError
from trackslip_drivers import conversions
from trackslip_drivers.can_parameters import CanDriverParameters
from trackslip_drivers.protocols.can_frames import STANDARD_FLAG
from trackslip_drivers.records import HydraulicsSample, SprocketSample, SwingSample
from trackslip_drivers.transports.can_bus import CanBus

S = 1_000_000_000


def over_virtual_bus(driver, sent, channel):
    """Samples by type that the driver makes of these frames, sent through python-can's virtual bus."""
    samples = defaultdict(list)
    port = CanBus("virtual", channel, {})
    with can.Bus(channel, interface="virtual", preserve_timestamps=True) as peer:
        for stamp_ns, arbitration_id, data in sent:
            is_extended = not arbitration_id & STANDARD_FLAG
            identifier = arbitration_id & ~STANDARD_FLAG
            stamp = stamp_ns * 1e-9
            peer.send(can.Message(stamp, identifier, is_extended_id=is_extended, data=data))
            for frame, arrival_ns in port.read():
                for sample in driver.receive(*frame, arrival_ns):
                    samples[type(sample)].append(sample)
    port.close()
    return samples


def test_a_bus_of_another_shape_by_its_roles_file(tmp_path):
    driver = machine(tmp_path)
    by_type = over_virtual_bus(driver, unseen_bus.frames(S, 11 * S), "unseen")
    assert set(driver.tally.total.values()) == {1}  # one count of each kind, listed below
    assert driver.decoder.frames_without_role == 200  # frames of the radio
    assert {kind: len(samples) for kind, samples in by_type.items()} == {
        SprocketSample: 500,
        HydraulicsSample: 199,  # the first pressures arrive before any spool positions
        SwingSample: 199,  # the first angle has no velocity
    }
    for sample in by_type[SprocketSample]:
        assert (sample.left_velocity, sample.right_velocity) == pytest.approx(unseen_bus.SPEEDS, abs=2e-3)
        assert math.isnan(sample.left_position)
    for sample in by_type[HydraulicsSample]:
        assert (sample.left_pressure, sample.right_pressure) == pytest.approx(unseen_bus.PRESSURES, abs=1e4)
        assert sample.supply_pressure == pytest.approx(unseen_bus.SUPPLY)
        assert (sample.left_spool, sample.right_spool) == pytest.approx(unseen_bus.SPOOLS)
    for sample in by_type[SwingSample][5:]:
        error = math.remainder(sample.position - unseen_bus.swing_at(sample.stamp_ns - S), 2.0 * math.pi)
        assert abs(error) < math.radians(0.06)
        assert sample.velocity == pytest.approx(unseen_bus.SWING_RATE, abs=0.02)
    intervals = np.diff([sample.stamp_ns for sample in by_type[SprocketSample]])
    assert intervals == pytest.approx(unseen_bus.FLOW_NS, abs=1000)
    assert driver.period == pytest.approx(0.02, rel=1e-3)  # measured: the DBC states no cycle
    swing = conversions.fill_swing(conversions.blank_swing(make, "base_link"), by_type[SwingSample][-1])
    assert (list(swing.name), len(swing.position), len(swing.velocity)) == (["swing"], 1, 1)
    blank = conversions.blank_track_hydraulics(make, "base_link")
    hydraulics = conversions.fill_track_hydraulics(blank, by_type[HydraulicsSample][-1])
    assert hydraulics.left_pressure == pytest.approx(78.84e5, abs=1e4)  # in Pa, not in the DBC's unit


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("left_flow:", "left_stream:", ("unknown role 'left_stream'", "accepted: left_position")),
        ("left_flow: TravelFlow.FlowL\n  ", "", ("role 'left_flow' is missing", "'right_flow'")),
        ("TravelFlow.FlowL", "TravelFlow.Flow", ("signal 'TravelFlow.Flow' is missing", "machine.dbc")),
        ("P_BR, minus", "P_XR, minus", ("signal 'P_XR' is missing",)),
        ("TravelFlow.FlowL", "TravelPorts.P_AL", ("'bar' is a unit of pressure", "accepted: m³/s")),
        (
            "supply_pressure: PumpMPa",
            "supply_pressure: Upper.Temperature",
            ("'degC' of the DBC is unknown", "Pa"),
        ),
        (', unit: "%"', "", ("the DBC has no unit", "accepted: unit: one of 1,")),
        (', unit: "%"', ", unit: parts", ("unit: 'parts' is unknown", "%")),
        (', unit: "%"', ", unit: bar", ("zero: '' is no pressure", "accepted: as 0.5 MPa")),
        (', unit: "%"', ", unit: rpm", ("'rpm' is a unit of angular speed", "accepted: 1,")),
        ("offset: 90.0", "unit: rad", ("unit: 'rad', but the DBC has 'deg'",)),
        ("TravelFlow.FlowR", "TravelFlow.FlowL", ("'left_flow' and 'right_flow'", "used twice")),
        ("minus: TravelPorts.P_BL", "minus: TravelPorts.P_AL", ("'left_pressure'", "used twice")),
        (
            "roles:\n",
            "roles:\n  left_speed: LeverL\n  right_speed: LeverR\n",
            ("roles 'left_speed', 'left_flow' overlap", "one of them"),
        ),
        ("roles:\n", "roles:\n  left_flow: TravelFlow.FlowR\n", ("'left_flow' is duplicated",)),
        ("sign: -1}\n  left_p", "sign: 2}\n  left_p", ("sign: 2 is out of range", "1 or -1")),
        ("sign: -1}\n  left_p", "sgn: -1}\n  left_p", ("unknown key 'sgn'", "accepted: signal")),
        ("sign: -1}\n  left_p", "ratio: 0}\n  left_p", ("ratio: 0 is out of range", "> 0")),
        ("sign: -1}\n  left_p", "ratio: fast}\n  left_p", ("ratio: 'fast' is not a number",)),
        ("sign: -1}\n  left_p", "source: 3}\n  left_p", ("'TravelFlow' is none of J1939",)),
        ("supply_pressure: PumpMPa", "supply_pressure: {unit: bar}", ("'signal' is missing",)),
        (unseen_bus.ROLES, "roles: {}\n", ("no roles", "accepted: left_position")),
        ("roles:", "rolls:", ("unknown section 'rolls'", "roles, frames")),
        ("roles:\n", "frames: {Radio: {counter: Volume}}\nroles:\n", ("frame 'Radio' has no role",)),
        ("roles:\n", "frames: {Upper: {counter: Count}}\nroles:\n", ("counter: signal 'Count' is missing",)),
        (
            "roles:\n",
            "frames: {Upper: {checksum: Temperature, checksum_type: md5}}\nroles:\n",
            ("checksum_type: 'md5' is unknown", "crc12_gsm, crc8_j1850, sum8, xor8"),
        ),
    ],
)
def test_wrong_roles_file_is_refused_in_one_line(tmp_path, old, new, words):
    text = refusal(tmp_path, old, new)
    assert [word for word in words if word not in text] == [], text


def test_an_ambiguous_signal_and_a_flow_without_hydraulics_are_refused(tmp_path):
    text = refusal(tmp_path, "PumpMPa", "PumpMPa", unseen_bus.DBC.replace("Volume", "PumpMPa"))
    assert "is in several frames; accepted: one of Upper.PumpMPa, Radio.PumpMPa" in text
    vehicle = dataclasses.replace(PARAMETERS.vehicle, hydraulics=None)
    with pytest.raises(InputError, match=r"'left_flow'.* vehicle 'pc05' has no hydraulics; accepted"):
        machine(tmp_path, vehicle=vehicle)


ENCODERS = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 291 LeftEncoder: 8 A
 SG_ Angle : 0|16@1+ (0.0109863,0) [0|360] "deg" A
 SG_ Beat : 56|3@1+ (1,0) [0|6] "" A
BO_ 292 RightEncoder: 8 A
 SG_ Ticks : 0|32@1- (1,0) [0|0] "pulses" A
 SG_ Beat : 56|4@1+ (1,0) [0|0] "" A
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 291 10;
BA_ "GenMsgCycleTime" BO_ 292 10;
"""
ENCODER_ROLES = """roles:
  left_position: {signal: LeftEncoder.Angle, ratio: 20.0}
  right_position: {signal: RightEncoder.Ticks, counts_per_turn: 600, ratio: 5.0, sign: -1}
"""
COUNTED = "frames: {LeftEncoder: {counter: Beat}, RightEncoder: {counter: Beat}}\n"


def encoder_frames(cycle_s, count, late=lambda k: 0.0):
    """Frames of two encoders at 2.5 and −1 rad/s of the sprockets."""
    database = cantools.database.load_string(ENCODERS, "dbc")
    for k in range(count):
        t = k * cycle_s
        angle = math.degrees(20.0 * 2.5 * t) % 360.0
        ticks = math.floor(-5.0 * -1.0 * t * 600 / (2.0 * math.pi))
        for name, values in (("LeftEncoder", {"Angle": angle}), ("RightEncoder", {"Ticks": ticks})):
            message = database.get_message_by_name(name)
            beat = k % (7 if name == "LeftEncoder" else 16)
            data = message.encode({**values, "Beat": beat}, strict=False)
            yield round((1.0 + t + late(k)) * S), message.frame_id | STANDARD_FLAG, data


@pytest.mark.parametrize("counter", ["", COUNTED], ids=["no counter", "counters"])
@pytest.mark.parametrize("cycle_s", [0.01, 0.02])
def test_encoders_of_any_resolution_sense_ratio_and_cycle(tmp_path, counter, cycle_s):
    """The DBC states a cycle of 10 ms; a sender of 50 Hz does not double the speed."""
    driver = machine(tmp_path, ENCODER_ROLES + counter, ENCODERS)
    samples = drive(driver, encoder_frames(cycle_s, 200))
    assert len(samples) >= 195
    turned = np.subtract(samples[-1][1:3], samples[0][1:3])
    assert turned / (samples[-1].stamp_ns - samples[0].stamp_ns) * S == pytest.approx([2.5, -1.0], abs=2e-3)
    assert np.mean([sample[3:] for sample in samples], axis=0) == pytest.approx([2.5, -1.0], abs=3e-3)
    assert [sample.left_velocity for sample in samples] == pytest.approx([2.5] * len(samples), abs=0.02)
    assert driver.period == pytest.approx(cycle_s, rel=1e-3)


def test_sides_at_50_and_20_hz_are_published_at_20_with_both_at_the_same_time(tmp_path):
    driver = machine(tmp_path, ENCODER_ROLES, ENCODERS)
    left, right = 291 | STANDARD_FLAG, 292 | STANDARD_FLAG
    sent = [one for one in encoder_frames(0.02, 251) if one[1] == left]
    sent += [one for one in encoder_frames(0.05, 101, lambda k: 0.007) if one[1] == right]
    samples = drive(driver, sorted(sent))
    assert len(samples) == pytest.approx(99, abs=3)
    first, last = samples[10], samples[-1]
    for sample in samples[10:]:
        seconds = (sample.stamp_ns - first.stamp_ns) * 1e-9
        assert sample.left_position - first.left_position == pytest.approx(2.5 * seconds, abs=2e-3)
        assert sample.right_position - first.right_position == pytest.approx(-seconds, abs=5e-3)
    assert (last.stamp_ns - first.stamp_ns) * 1e-9 == pytest.approx(0.05 * (len(samples) - 11), abs=0.06)


def test_a_sender_that_stalls_and_catches_up_without_a_counter(tmp_path):
    """Speeds stay bounded in the stall; the total rotation equals the true one."""
    driver = machine(
        tmp_path, ENCODER_ROLES.replace("20.0", "1.0"), ENCODERS.replace("(0.0109863", "(0.0054932")
    )
    late = {k: 0.15 - 0.0099 * (k - 60) for k in range(60, 76)}
    samples = drive(driver, encoder_frames(0.01, 200, lambda k: max(late.get(k, 0.0), 0.0)))
    speeds = np.diff([s.right_position for s in samples]) / np.diff([s.stamp_ns * 1e-9 for s in samples])
    assert np.abs(speeds + 1.0).max() < 1.0
    turned = samples[-1].right_position - samples[0].right_position
    assert turned == pytest.approx(-(samples[-1].stamp_ns - samples[0].stamp_ns) * 1e-9, abs=0.01)
    assert ("RightEncoder", "lost") not in driver.tally.total


J1939 = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 2566845438 TrackMotor: 8 A
 SG_ Speed : 0|16@1+ (0.125,-4000) [-4000|4031.875] "rpm" A
 SG_ Kind m0 : 16|8@1+ (1,0) [0|255] "" A
 SG_ Page M : 24|4@1+ (1,0) [0|15] "" A
 SG_ Pressure m1 : 32|16@1+ (0.5,0) [0|0] "kPa" A
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "ExtendedCAN";
BA_ "VFrameFormat" BO_ 2566845438 3;
"""
J1939_ROLES = """roles:
  left_speed: {signal: Speed, source: 0x21, ratio: 25.26}
  right_speed: {signal: Speed, source: 0x22, ratio: 25.26, sign: -1}
  supply_pressure: {signal: Pressure, source: 0x21}
"""


def test_j1939_by_parameter_group_and_sender(tmp_path):
    driver = machine(tmp_path, J1939_ROLES, J1939)
    database = cantools.database.load_string(J1939, "dbc")
    group = database.messages[0].frame_id & 0x00FFFF00
    received = []
    for k in range(20):
        for source, rpm in ((0x21, 400.0), (0x22, -300.0), (0x23, 4000.0)):
            values = {"Speed": rpm, "Page": k % 2, **({"Pressure": 18600.0} if k % 2 else {"Kind": 0})}
            data = database.messages[0].encode(values)
            priority = 3 + k % 4
            received += driver.receive(priority << 26 | group | source, data, k * 20_000_000)
    sprockets = [sample for sample in received if isinstance(sample, SprocketSample)]
    hydraulics = [sample for sample in received if isinstance(sample, HydraulicsSample)]
    assert (len(sprockets), len(hydraulics)) == (20, 10)
    expected = 2.0 * math.pi / 60.0 / 25.26 * np.array((400.0, 300.0))
    assert sprockets[-1][3:] == pytest.approx(expected)
    assert hydraulics[-1].supply_pressure == 18.6e6
    assert math.isnan(hydraulics[-1].left_pressure)
    assert driver.decoder.frames_without_role == 0
    not_available = b"\xff" * 8
    assert driver.receive(3 << 26 | group | 0x21, not_available, S) == []
    assert driver.tally.total["TrackMotor", "out of range"] == 1


def test_senders_at_a_time_are_ambiguous_and_a_changed_address_or_a_past_sender_is_not(tmp_path):
    roles = "roles: {left_speed: MC.L, right_speed: MC.R}\nframes: {MC: {j1939: true}}\n"
    dbc = """VERSION ""
BU_: MC
BO_ 2566848766 MC: 8 MC
 SG_ L : 0|16@1+ (0.125,-4000) [0|0] "rpm" X
 SG_ R : 16|16@1+ (0.125,-4000) [0|0] "rpm" X
"""
    driver, data = machine(tmp_path, roles, dbc), bytes.fromhex("A07D607C00000000")

    def run(begin_s, end_s, *sources):
        for time_s in np.arange(begin_s, end_s, 0.02):
            for source in sources:
                driver.receive(0x18FF0000 | source, data, round(time_s * S))

    run(0, 3, 0x21)
    run(3, 6, 0x47)
    assert driver.decoder.ambiguous_source_message() == ""
    run(6, 8, 0x47, 0x22)
    assert "0x22 and 0x47" in driver.decoder.ambiguous_source_message(is_live=True)
    run(8, 15, 0x47)
    assert driver.decoder.ambiguous_source_message(is_live=True) == ""
    assert "0x22 and 0x47" in driver.decoder.ambiguous_source_message()


@pytest.mark.parametrize(
    ("changes", "options"),
    [
        ({}, {}),
        ({"can_interface": "udp_multicast", "can_port": 20002}, {"port": 20002}),
        ({"can_interface": "socketcand", "can_host": "me", "can_port": 2953}, {"host": "me", "port": 2953}),
        ({"can_bitrate": 250000, "can_options": ("a=7", "fd=true")}, {"bitrate": 250000, "a": 7, "fd": True}),
    ],
)
def test_settings_reach_python_can(changes, options):
    p: CanDriverParameters = dataclasses.replace(PARAMETERS, **changes)
    assert p.bus_options() == options


@pytest.mark.parametrize("text", ["fd", "=1", "a b=1"])
def test_malformed_can_option_is_refused(text):
    with pytest.raises(InputError, match=f"can_options: '{text}'; accepted: NAME=VALUE"):
        dataclasses.replace(PARAMETERS, can_options=(text,)).bus_options()
