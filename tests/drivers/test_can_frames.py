# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Frames of the excavator: exact bytes, each reason for rejection, the resulting samples, any bytes."""

import itertools
import math

import numpy as np
import pytest
from cantools.database.errors import EncodeError
from crccheck.crc import Crc8SaeJ1850, Crc12Gsm  # type: ignore[import-untyped]
from fixtures.excavator_bus import CYCLE_NS, FRAMES, PARAMETERS

from trackslip_common.config_files import config_file
from trackslip_common.errors import InputError
from trackslip_common.tally import Tally
from trackslip_drivers.protocols.can_codec import CHECKSUMS
from trackslip_drivers.protocols.can_frames import (
    BUS,
    ERROR_FLAG,
    STANDARD_FLAG,
    FrameDecoder,
    FrameSet,
    Rejection,
)
from trackslip_drivers.protocols.excavator_can import ExcavatorCan
from trackslip_drivers.records import HydraulicsSample, SprocketSample
from trackslip_sim.devices.can_device import ENCODERS, PRESSURES, SPOOLS

COUNTS = {"left_count": 0xABC, "right_count": 0x123}
PRESSURE = {"left_pressure": -18.6e6, "right_pressure": 25e6, "supply_pressure": 12.345e6}
SPOOL = {"left_spool": -1.0, "right_spool": 0.5}


@pytest.fixture
def tally():
    return Tally()


@pytest.fixture
def decoder(tally):
    return FrameDecoder(FRAMES, tally)


@pytest.fixture
def excavator(tally):
    return ExcavatorCan(PARAMETERS, FRAMES, tally)


def frame_set(dbc):
    return FrameSet(dbc, config_file("can_roles.yaml"), PARAMETERS.vehicle)


@pytest.mark.parametrize(
    ("name", "values", "alive", "expected_id", "expected"),
    [
        (ENCODERS, COUNTS, 0, 0x0CFF1080, "bc 0a 23 01 00 00 c0 a7"),
        (SPOOLS, SPOOL, 15, 0x0CFF1180, "f0 d8 88 13 00 00 ef 9f"),
        (PRESSURES, PRESSURE, 17, 0x0CFF1280, "58 b7 a8 61 39 30 b1 42"),
    ],
)
def test_exact_bytes(decoder, name, values, alive, expected_id, expected):
    arbitration_id, data = FRAMES.encode(name, values, alive)
    assert (arbitration_id, data) == (expected_id, bytes.fromhex(expected))
    (frame,) = decoder.decode(arbitration_id, data, 5)
    assert (frame.name, frame.stamp_ns, frame.elapsed_ns) == (name, 5, 0)
    assert dict(frame.values) == pytest.approx(values)


def test_range_and_cycle_are_those_of_the_dbc():
    assert {codec.nominal_ns for codec in FRAMES.codecs.values()} == {CYCLE_NS}
    with pytest.raises(EncodeError):
        FRAMES.encode(PRESSURES, {**PRESSURE, "left_pressure": 26e6}, 0)


def test_unknown_frames_are_ignored_and_error_frames_counted(decoder, tally):
    _, data = FRAMES.encode(ENCODERS, COUNTS, 0)
    assert decoder.decode(0x0CFF1081, data, 0) == ()
    assert decoder.decode(0x0CFF1080 | STANDARD_FLAG, data, 0) == ()
    assert decoder.decode(ERROR_FLAG | 0x40, bytes(8), 0) is Rejection.ERROR_FRAME
    assert tally.total == {(BUS, "error frame"): 1}
    assert decoder.frames_without_role == 2  # frames with other identifiers are normal and give no warning


def test_damage_is_rejected_and_commits_nothing(decoder, tally):
    arbitration_id, data = FRAMES.encode(ENCODERS, COUNTS, 3)
    assert decoder.decode(arbitration_id, data[:7], 0) is Rejection.WRONG_LENGTH
    for place, error in itertools.product(range(8), range(1, 256)):
        damaged = bytearray(data)
        damaged[place] ^= error
        assert decoder.decode(arbitration_id, bytes(damaged), 0) is Rejection.CHECKSUM
    other_id, _ = FRAMES.encode(SPOOLS, SPOOL, 3)
    assert decoder.decode(other_id, data, 0) is Rejection.CHECKSUM  # identifier of another message
    assert len(decoder.decode(arbitration_id, data, 0)) == 1
    assert tally.total[ENCODERS, "checksum"] == 8 * 255


def test_raw_value_outside_the_range_of_the_dbc_is_rejected(decoder, tally):
    frame_id, payload = 0x0CFF1280, bytes.fromhex("00 80 00 00 00 00 00 00")  # -32768 kPa: "not available"
    assert (
        decoder.decode(frame_id, FRAMES.codecs[PRESSURES].replace_checksum(frame_id, payload), 0)
        is Rejection.OUT_OF_RANGE
    )
    assert tally.total[PRESSURES, "out of range"] == 1


def receive(decoder, alive, cycle):
    """Elapsed cycles before each frame whose time is settled by this call."""
    timed = decoder.decode(*FRAMES.encode(SPOOLS, SPOOL, alive), round(cycle * CYCLE_NS))
    return [frame.elapsed_ns / CYCLE_NS for frame in timed]


def test_stuck_counter_stays_rejected(decoder, tally):
    assert receive(decoder, 6, -1) == [0]
    assert receive(decoder, 7, 0) == [1]
    for cycle in range(1, 100):
        assert receive(decoder, 7, cycle) == []
    for alive in (8, 9):
        assert receive(decoder, alive, alive + 92) == []
    assert receive(decoder, 10, 102) == [97, 1, 1]  # the 4-bit counter has wrapped six times by then
    assert tally.total[SPOOLS, "alive counter repeated"] == 99


@pytest.mark.parametrize("lost", [0, 1, 15, 16, 76, 1000])
@pytest.mark.parametrize("late", [-0.3, 2.0])
def test_lost_frames_are_counted_and_the_next_is_accepted(decoder, tally, lost, late):
    for n in range(3):
        receive(decoder, 7 + n, n - 2)
    elapsed = []
    for n in range(lost + 1, lost + 4):
        elapsed += receive(decoder, 9 + n, round(n + late))
    assert elapsed == [lost + 1, 1, 1]
    assert tally.total[SPOOLS, "lost"] == lost


def test_sprockets_of_a_sender_that_stalls_for_150_ms_keep_their_speed(excavator, tally):
    per_count, speeds, positions = 2.0 * math.pi / 12288, [], []
    for k in range(100):
        arrival = max(k, 65.0 + 0.05 * (k - 50)) if 50 <= k < 66 else k
        count = math.floor(2.5 * k * 0.01 / per_count) % 4096
        sent = FRAMES.encode(ENCODERS, {"left_count": count, "right_count": count}, k)
        for sample in excavator.receive(*sent, round(arrival * CYCLE_NS)):
            speeds.append(sample.left_velocity)
            positions.append(sample.left_position - 2.5 * sample.stamp_ns * 1e-9)
    assert len(speeds) == 99
    assert speeds == pytest.approx([2.5] * 99, abs=0.06)
    assert np.ptp(positions) < 2.5 * 1e-3  # stamps are measurement times, not arrival times
    assert (ENCODERS, "lost") not in tally.total


def test_clock_set_back(decoder):
    receive(decoder, 3, 1_000_000)
    assert receive(decoder, 4, 0) == [0]


def test_samples(excavator, tally):
    received = []
    for cycle in range(3):
        counts = {"left_count": (4095 + 10 * cycle) % 4096, "right_count": 5 - 2 * cycle}
        for name, values in ((ENCODERS, counts), (SPOOLS, SPOOL), (PRESSURES, PRESSURE)):
            received.append(excavator.receive(*FRAMES.encode(name, values, cycle), cycle * CYCLE_NS))
    assert received[:2] == [[], []]
    (hydraulics,) = received[2]
    assert isinstance(hydraulics, HydraulicsSample)
    assert hydraulics.left_pressure == -18.6e6
    assert hydraulics.right_spool == 0.5
    (sprockets,) = received[6]
    assert isinstance(sprockets, SprocketSample)
    assert sprockets.stamp_ns == 2 * CYCLE_NS
    per_count = 2.0 * 3.141592653589793 / 12288
    assert sprockets.left_position == pytest.approx((4095 + 20) * per_count)
    assert sprockets.left_velocity == pytest.approx(10 * per_count / 0.01)
    assert sprockets.right_velocity == pytest.approx(-2 * per_count / 0.01)
    assert not tally.total


def test_pressures_without_recent_spools(excavator, tally):
    assert excavator.receive(*FRAMES.encode(PRESSURES, PRESSURE, 0), 0) == []
    excavator.receive(*FRAMES.encode(SPOOLS, SPOOL, 0), 0)
    assert len(excavator.receive(*FRAMES.encode(PRESSURES, PRESSURE, 1), CYCLE_NS)) == 1
    assert excavator.receive(*FRAMES.encode(PRESSURES, PRESSURE, 12), 12 * CYCLE_NS) == []
    assert tally.total["HydraulicsSample", "no recent value of the other frame"] == 2


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('] "count"', "]", "frame 'encoders' there: "),
        ("alive_counter : 48|4@1+", "alive_counter : 48|4@1-", "'alive_counter' is no unsigned whole number"),
        ("checksum : 52|12", "checksum : 56|8", "'checksum' has 8 bits; accepted: 12"),
    ],
)
def test_broken_dbc_is_refused_in_one_line(tmp_path, old, new, message):
    text = config_file("excavator.dbc").read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "broken.dbc"
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        frame_set(path)
    assert "\n" not in str(caught.value)


def test_missing_dbc_and_one_of_more_than_8_mb_are_refused(tmp_path):
    with pytest.raises(InputError, match="not a usable DBC"):
        frame_set(tmp_path / "large.dbc")
    with (tmp_path / "large.dbc").open("wb") as file:
        file.truncate(2**33)
    with pytest.raises(InputError, match=r"large\.dbc: more than 8 MB; accepted: a DBC"):
        frame_set(tmp_path / "large.dbc")


BIG_ENDIAN = (
    ("left_pressure : 0|16@1-", "left_pressure : 7|16@0-"),
    ("right_pressure : 16|16@1-", "right_pressure : 20|13@0-"),
    ("left_count : 0|12@1+ (1,0)", "left_count : 3|12@0+ (1,-7)"),
)


@pytest.mark.parametrize("changes", [(), BIG_ENDIAN], ids=["as it is", "other byte order"])
def test_payloads_are_those_of_cantools(changes, tmp_path):
    text = config_file("excavator.dbc").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "bus.dbc").write_text(text.replace('[0|4095] "count"', '[0|4000] "count"'))
    frames, rng = frame_set(tmp_path / "bus.dbc"), np.random.default_rng(0)
    for name, message in frames.by_name.items():
        signals = [s for s in message.signals if s.name not in ("alive_counter", "checksum")]
        for alive in range(40):
            share = rng.random(len(signals)) * 0.1 + 0.45  # within the range of the shorter signals
            low_high = [(float(s.minimum), float(s.maximum)) for s in signals]
            values = {
                s.name: low + part * (high - low)
                for s, part, (low, high) in zip(signals, share.tolist(), low_high, strict=True)
            }
            frame_id, payload = frames.encode(name, values, alive)
            theirs = message.encode({**values, "alive_counter": alive % 16, "checksum": 0})
            assert payload == frames.codecs[name].replace_checksum(frame_id, theirs)
            unpacked = frames.codecs[name].unpack(
                *(int.from_bytes(payload, order) for order in ("little", "big"))
            )
            scaling = name != ENCODERS  # positions are raw counts
            decoded = message.decode_simple(payload, scaling=scaling)
            assert unpacked == {k: v for k, v in decoded.items() if k in values}


def test_checksums_are_the_published_ones():
    rng = np.random.default_rng(0)
    codec = FRAMES.codecs[ENCODERS]
    for _ in range(7):
        frame_id, data = int(rng.integers(1 << 29)), rng.bytes(8)
        alive = data[-2] & 0xF
        crc = Crc12Gsm.calc(frame_id.to_bytes(4, "big") + data[:-2] + bytes((alive,)))
        assert codec.replace_checksum(frame_id, data) == data[:-2] + (alive | crc << 4).to_bytes(2, "little")
    data = rng.bytes(7)
    assert CHECKSUMS["crc8_j1850"][1](0x123, data) == Crc8SaeJ1850.calc(data)
    assert CHECKSUMS["sum8"][1](0x123, data) == sum(data) % 256
    assert CHECKSUMS["xor8"][1](0x123, b"\x0f\xff\x01") == 0xF1
