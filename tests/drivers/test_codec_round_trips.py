# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Ten thousand random valid records through each codec and back, seeded."""

from typing import Any

import numpy as np
import pytest
from fixtures.excavator_bus import CYCLE_NS, FRAMES

from trackslip_common.config_files import node_defaults
from trackslip_common.parameters import from_flat
from trackslip_common.tally import Tally
from trackslip_drivers.protocols.can_frames import FrameDecoder
from trackslip_drivers.protocols.sick_scan import Scan, decode_scan, encode_scan
from trackslip_drivers.protocols.sick_telegram import FROM_SENSOR, Telegram, TelegramParser, frame
from trackslip_drivers.protocols.watson import (
    Layout,
    Reading,
    decode_frame,
    decode_line,
    encode_frame,
    encode_line,
)
from trackslip_drivers.records import ScanSample
from trackslip_drivers.sick_parameters import SickParameters
from trackslip_drivers.watson_parameters import WatsonParameters
from trackslip_sim.devices.can_device import ENCODERS, PRESSURES, SPOOLS

RECORDS = 10_000
PLS = from_flat(SickParameters, node_defaults("sick_pls", "sick_pls.yaml"), "sick_pls")
WATSON = from_flat(WatsonParameters, node_defaults("watson_imu", "watson_imu.yaml"), "watson_imu")
LAYOUT = Layout(WATSON.channels, WATSON.formats, WATSON.full_scales)


def random_scan(rng: np.random.Generator) -> ScanSample:
    ranges = rng.integers(6, 5000, 361) * 0.01
    ranges[rng.random(361) < 0.05] = np.inf
    return ScanSample(
        0, -np.pi / 2.0, np.pi / 360.0, 0.04 / 720.0, 0.04, PLS.range_min, PLS.range_max, ranges
    )


def test_sick_scans() -> None:
    rng = np.random.default_rng(1)
    parser = TelegramParser(FROM_SENSOR, PLS.serial_baud, PLS.bits_per_char, Tally(), "scan")
    for _ in range(RECORDS):
        sent = random_scan(rng)
        (telegram,) = parser.feed(frame(encode_scan(sent, PLS), FROM_SENSOR), 0)
        assert isinstance(telegram, Telegram)
        scan = decode_scan(telegram, PLS)
        assert isinstance(scan, Scan)
        np.testing.assert_allclose(scan.sample.ranges, sent.ranges, atol=1e-9)
    assert parser.bytes_held == 0


@pytest.mark.parametrize("binary", [False, True], ids=["lines", "frames"])
def test_watson_readings(binary: bool) -> None:
    rng = np.random.default_rng(2)
    scales = np.array([channel.full_scale for channel in LAYOUT.channels])
    digits = np.array([10.0**-channel.decimals for channel in LAYOUT.channels])
    steps = scales / 8192 if binary else digits
    names = [channel.name for channel in LAYOUT.channels]
    for _ in range(RECORDS):
        values = rng.uniform(-0.999, 0.999, len(names)) * scales
        given = dict(zip(names, values.tolist(), strict=True))
        if binary:
            reading = decode_frame(encode_frame(given, LAYOUT)[:-1], LAYOUT)
        else:
            reading = decode_line(encode_line("R", given, LAYOUT)[:-1], LAYOUT)
        assert isinstance(reading, Reading)
        error = np.abs(np.array([reading.values[name] for name in names]) - values)
        assert (error <= 1.000001 * steps).all()


@pytest.mark.parametrize("name", [ENCODERS, SPOOLS, PRESSURES])
def test_can_frames(name: str) -> None:
    rng = np.random.default_rng(3)
    decoder = FrameDecoder(FRAMES, Tally())
    message = FRAMES.by_name[name]
    signals = [s for s in message.signals if s.name not in ("alive_counter", "checksum")]
    for count in range(RECORDS):
        values = {s.name: float(rng.uniform(float(s.minimum or 0), float(s.maximum or 0))) for s in signals}
        if name == ENCODERS:
            values = {signal: float(round(value)) for signal, value in values.items()}
        frames: Any = decoder.decode(*FRAMES.encode(name, values, count), count * CYCLE_NS)
        (found,) = frames
        assert found.elapsed_ns == (CYCLE_NS if count else 0)
        for signal in signals:
            assert abs(found.values[signal.name] - values[signal.name]) <= 0.5000001 * float(signal.scale)
