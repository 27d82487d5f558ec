# SPDX-License-Identifier: Apache-2.0
"""The frames of the excavator: exact bytes, each rejection, and the samples made of them."""

import itertools

import numpy as np
import pytest
from cantools.database.errors import EncodeError
from crccheck.crc import Crc12Gsm

from trackslip_common.config_files import config_file, read_yaml
from trackslip_common.errors import InputError
from trackslip_common.parameters import from_flat
from trackslip_common.tally import Tally
from trackslip_drivers.can_parameters import CanDriverParameters
from trackslip_drivers.protocols.can_frames import (
    BUS,
    ENCODERS,
    ERROR_FLAG,
    PRESSURES,
    SPOOLS,
    Frame,
    FrameDecoder,
    FrameSet,
    Rejection,
    sealed,
)
from trackslip_drivers.protocols.excavator_can import ExcavatorCan
from trackslip_drivers.records import HydraulicsSample, SprocketSample

CYCLE_NS = 10_000_000
COUNTS = {"left_count": 0xABC, "right_count": 0x123}
PRESSURE = {"left_pressure": -18.6e6, "right_pressure": 25e6, "supply_pressure": 12.345e6}
SPOOL = {"left_spool": -1.0, "right_spool": 0.5}


@pytest.fixture(scope="module")
def frames():
    return FrameSet(config_file("excavator.dbc"))


@pytest.fixture
def tally():
    return Tally()


@pytest.fixture
def decoder(frames, tally):
    return FrameDecoder(frames, tally)


@pytest.fixture
def excavator(frames, tally):
    values = read_yaml(config_file("can_driver.yaml"))["can_driver"]["ros__parameters"]
    return ExcavatorCan(from_flat(CanDriverParameters, values, "can_driver.yaml"), frames, tally)


@pytest.mark.parametrize(
    ("name", "values", "alive", "expected_id", "expected"),
    [
        (ENCODERS, COUNTS, 0, 0x0CFF1080, "bc 0a 23 01 00 00 c0 a7"),
        (SPOOLS, SPOOL, 15, 0x0CFF1180, "f0 d8 88 13 00 00 ef 9f"),
        (PRESSURES, PRESSURE, 17, 0x0CFF1280, "58 b7 a8 61 39 30 b1 42"),
    ],
)
def test_exact_bytes(frames, decoder, name, values, alive, expected_id, expected):
    arbitration_id, data = frames.encode(name, values, alive)
    assert (arbitration_id, data) == (expected_id, bytes.fromhex(expected))
    frame = decoder.decode(arbitration_id, data, 5)
    assert isinstance(frame, Frame)
    assert (frame.name, frame.stamp_ns, frame.cycles) == (name, 5, 0)
    assert dict(frame.values) == pytest.approx(values)


def test_encoding_refuses_what_the_contract_cannot_hold(frames):
    with pytest.raises(EncodeError):
        frames.encode(PRESSURES, {**PRESSURE, "left_pressure": 26e6}, 0)


def test_cycle_comes_from_the_contract(frames):
    assert frames.cycle_ns == CYCLE_NS


def test_strangers_and_error_frames(decoder, tally, frames):
    _, data = frames.encode(ENCODERS, COUNTS, 0)
    assert decoder.decode(0x0CFF1081, data, 0) is Rejection.UNKNOWN_ID
    assert decoder.decode(0x0CFF1080 | 1 << 31, data, 0) is Rejection.UNKNOWN_ID
    assert decoder.decode(ERROR_FLAG | 0x40, bytes(8), 0) is Rejection.ERROR_FRAME
    assert tally.total == {(BUS, "unknown id"): 2, (BUS, "error frame"): 1}


def test_damage_is_rejected_and_commits_nothing(decoder, tally, frames):
    arbitration_id, data = frames.encode(ENCODERS, COUNTS, 3)
    assert decoder.decode(arbitration_id, data[:7], 0) is Rejection.WRONG_LENGTH
    for place, error in itertools.product(range(8), range(1, 256)):
        damaged = bytearray(data)
        damaged[place] ^= error
        assert decoder.decode(arbitration_id, bytes(damaged), 0) is Rejection.CHECKSUM
    other_id, _ = frames.encode(SPOOLS, SPOOL, 3)
    assert decoder.decode(other_id, data, 0) is Rejection.CHECKSUM  # right bytes under a wrong id
    assert isinstance(decoder.decode(arbitration_id, data, 0), Frame)
    assert tally.total[ENCODERS, "checksum"] == 8 * 255


def test_raw_value_outside_the_contract(decoder, tally):
    frame_id, payload = 0x0CFF1280, bytes.fromhex("00 80 00 00 00 00 00 00")  # -32768 kPa: "not available"
    assert decoder.decode(frame_id, sealed(frame_id, payload), 0) is Rejection.OUT_OF_RANGE
    assert tally.total[PRESSURES, "out of range"] == 1


def receive(decoder, frames, alive, cycle):
    return decoder.decode(*frames.encode(SPOOLS, SPOOL, alive), cycle * CYCLE_NS)


def test_stuck_counter_stays_rejected(decoder, frames, tally):
    assert receive(decoder, frames, 7, 0).cycles == 0
    for cycle in range(1, 100):
        assert receive(decoder, frames, 7, cycle) is Rejection.ALIVE_REPEATED
    assert receive(decoder, frames, 8, 100).cycles == 97  # by then six turns of the counter have passed
    assert tally.total[SPOOLS, "alive counter repeated"] == 99


@pytest.mark.parametrize("lost", [0, 1, 14, 15, 16, 40, 1000])
@pytest.mark.parametrize("late", [-0.3, 0.0, 2.0])
def test_lost_frames_are_counted_and_the_next_is_accepted(decoder, frames, tally, lost, late):
    receive(decoder, frames, 9, 0)
    assert receive(decoder, frames, 9 + lost + 1, round(lost + 1 + late)).cycles == lost + 1
    assert tally.total[SPOOLS, "lost"] == lost


def test_sender_that_stalls_and_catches_up_loses_nothing(decoder, frames, tally):
    receive(decoder, frames, 0, 0)
    for alive in range(1, 12):
        assert receive(decoder, frames, alive, 11).cycles == 1
    assert not tally.total


def test_clock_set_back(decoder, frames):
    receive(decoder, frames, 3, 1_000_000)
    assert receive(decoder, frames, 4, 0).cycles == 1


def test_samples(excavator, frames, tally):
    received = []
    for cycle in range(3):
        counts = {"left_count": (4095 + 10 * cycle) % 4096, "right_count": 5 - 2 * cycle}
        for name, values in ((ENCODERS, counts), (SPOOLS, SPOOL), (PRESSURES, PRESSURE)):
            received.append(excavator.receive(*frames.encode(name, values, cycle), cycle * CYCLE_NS))
    assert received[:2] == [None, None]
    assert isinstance(received[2], HydraulicsSample)
    assert received[2].left_pressure == -18.6e6
    assert received[2].right_spool == 0.5
    sprockets = received[6]
    assert isinstance(sprockets, SprocketSample)
    assert sprockets.stamp_ns == 2 * CYCLE_NS
    per_count = 2.0 * 3.141592653589793 / 12288
    assert sprockets.left_position == pytest.approx((4095 + 20) * per_count)
    assert sprockets.left_velocity == pytest.approx(10 * per_count / 0.01)
    assert sprockets.right_velocity == pytest.approx(-2 * per_count / 0.01)
    assert tally.total == {("left_encoder", "first reading"): 1, ("right_encoder", "first reading"): 1}


def test_pressures_without_recent_spools(excavator, frames, tally):
    assert excavator.receive(*frames.encode(PRESSURES, PRESSURE, 0), 0) is None
    excavator.receive(*frames.encode(SPOOLS, SPOOL, 0), 0)
    assert excavator.receive(*frames.encode(PRESSURES, PRESSURE, 1), CYCLE_NS) is not None
    assert excavator.receive(*frames.encode(PRESSURES, PRESSURE, 12), 12 * CYCLE_NS) is None
    assert tally.total[PRESSURES, "no recent spools"] == 2


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("SG_ left_count", "SG_ port_count", "signal 'left_count' of frame 'encoders' is missing"),
        ('] "count"', "]", "not a usable DBC"),
        ("right_count : 16|12", "right_count : 4|12", "not a usable DBC"),
        (" pressures: 8", " pressure: 8", "frame 'pressures' is missing"),
        ("BO_ 2365526144 10", "BO_ 2365526144 20", "the same for all frames"),
        ("alive_counter : 48|4", "alive_counter : 48|3", "must end in 4 bits alive_counter, 12 bits"),
        ("checksum : 52|12", "checksum : 56|8", "must end in 4 bits alive_counter, 12 bits"),
    ],
)
def test_broken_contract_is_refused_in_one_line(tmp_path, old, new, message):
    text = config_file("excavator.dbc").read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "broken.dbc"
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        FrameSet(path)
    assert "\n" not in str(caught.value)


def test_missing_contract():
    with pytest.raises(InputError, match="not a usable DBC"):
        FrameSet(config_file("can_driver.yaml").with_name("none.dbc"))


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
    frames, rng = FrameSet(tmp_path / "bus.dbc"), np.random.default_rng(0)
    for name, message in frames.by_name.items():
        signals = [s for s in message.signals if s.name not in ("alive_counter", "checksum")]
        for alive in range(200):
            share = rng.random(len(signals)) * 0.1 + 0.45  # within what fewer bits can hold
            low_high = [(float(s.minimum), float(s.maximum)) for s in signals]
            values = {
                s.name: low + part * (high - low)
                for s, part, (low, high) in zip(signals, share.tolist(), low_high, strict=True)
            }
            frame_id, payload = frames.encode(name, values, alive)
            theirs = message.encode({**values, "alive_counter": alive % 16, "checksum": 0})
            assert payload == sealed(frame_id, theirs)
            found = frames.codecs[frame_id].unpack(payload)
            assert found == {k: v for k, v in message.decode_simple(payload).items() if k in values}


def test_a_floating_point_signal_is_refused(tmp_path):
    text = config_file("excavator.dbc").read_text()
    for old, new in (
        ("left_pressure : 0|16@1-", "left_pressure : 0|8@1-"),
        ("right_pressure : 16|16@1-", "right_pressure : 8|8@1-"),
        ("supply_pressure : 32|16@1+ (1000,0)", "supply_pressure : 16|32@1- (1,0)"),
    ):
        text = text.replace(old, new)
    (tmp_path / "bus.dbc").write_text(text + "\nSIG_VALTYPE_ 2365526656 supply_pressure : 1;\n")
    with pytest.raises(InputError, match=r"'supply_pressure' is a floating-point one; accepted: integers"):
        FrameSet(tmp_path / "bus.dbc")


def test_the_checksum_is_crc_12_gsm():
    rng = np.random.default_rng(0)
    for length in range(2, 9):
        frame_id, data = int(rng.integers(1 << 29)), rng.bytes(length)
        alive = data[-2] & 0xF
        crc = Crc12Gsm.calc(frame_id.to_bytes(4, "big") + data[:-2] + bytes((alive,)))
        assert sealed(frame_id, data) == data[:-2] + (alive | crc << 4).to_bytes(2, "little")
