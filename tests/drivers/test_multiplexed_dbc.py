# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Decoded payloads equal those of cantools: multiplexers, byte orders, signs, floats, scales."""

import json
from pathlib import Path
from typing import Any

import pytest
from cantools.database.errors import DecodeError
from fixtures.dbc_text import VENDORED, Signal, dbc
from hypothesis import given
from hypothesis import strategies as st

from trackslip_drivers.protocols.can_codec import Codec, Protection
from trackslip_drivers.protocols.can_dbc import read_dbc

LENGTH = 16  # bytes of a frame
PAYLOADS = st.lists(st.binary(min_size=LENGTH, max_size=LENGTH), min_size=1, max_size=20)
FRAMES: list[dict[str, Any]] = json.loads(VENDORED.read_text(encoding="utf-8"))


@st.composite
def trees(draw: st.DrawFn) -> list[Signal]:
    """Up to three nested multiplexers of two bits each, with signals below them."""
    depth = draw(st.integers(1, 3))
    signals = [Signal("M0", 0, 2, is_multiplexer=True)]
    selectors = st.sampled_from([(0,), (1,), (2, 3), (0, 3), (1, 2)])
    for k in range(1, depth):
        below = {"above": f"M{k - 1}", "selectors": draw(selectors)}
        signals.append(Signal(f"M{k}", 2 * k, 2, is_multiplexer=True, **below))
    for k in range(draw(st.integers(1, 6))):
        above = f"M{draw(st.integers(0, depth - 1))}"
        signals.append(Signal(f"S{k}", 8 + 8 * k, 8, above=above, selectors=draw(selectors)))
    return signals


@st.composite
def places(draw: st.DrawFn) -> list[Signal]:
    """Signals of any kind, possibly overlapping."""
    signals = []
    numbers = st.one_of(st.integers(-1000, 1000), st.sampled_from([0.1, -0.5, 1e-7, 360 / 65536, 2.5e6]))
    for k in range(draw(st.integers(1, 8))):
        is_big, is_float = draw(st.booleans()), draw(st.booleans())
        bits = draw(st.sampled_from([16, 32, 64]) if is_float else st.integers(1, 64))
        first = draw(st.integers(0, 8 * LENGTH - bits))
        start = first // 8 * 8 + 7 - first % 8 if is_big else first
        scale = draw(numbers.filter(bool))
        signed = is_float or draw(st.booleans())
        signals.append(Signal(f"S{k}", start, bits, is_big, signed, is_float, scale, draw(numbers)))
    return signals


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("dbc") / "bus.dbc"


def codec(path: Path, length: int, signals: list[Signal]) -> Codec:
    """Codec of a frame with these signals."""
    path.write_text(dbc("Frame", length, signals), encoding="utf-8")
    (message,) = read_dbc(path).database.messages
    return Codec(message, [signal.name for signal in signals], (), Protection())


def unpacked(decoder: Codec, data: bytes) -> dict[str, float] | None:
    """Signal values in ``data``, by name; None if the decoder rejects it."""
    return decoder.unpack(int.from_bytes(data, "little"), int.from_bytes(data, "big"))


@given(st.one_of(trees(), places()), PAYLOADS)
def test_multiplexed_values_equal_those_of_cantools(
    path: Path, signals: list[Signal], payloads: list[bytes]
) -> None:
    decoder = codec(path, LENGTH, signals)
    (message,) = read_dbc(path).database.messages
    for data in payloads:
        try:
            expected = message.decode(data, decode_choices=False)
        except DecodeError:  # a selector without signals
            continue
        values = unpacked(decoder, data)
        finite = {name: value for name, value in expected.items() if abs(value) < float("inf")}
        if len(finite) < len(expected):  # NaN and infinity are no values
            assert values is None
        else:
            assert values == {name: float(value) for name, value in expected.items()}


def test_values_equal_those_of_cantools_if_all_are_in_range(path: Path) -> None:
    for row in FRAMES:
        signals = [Signal(*facts) for facts in row["signals"]]
        decoder = codec(path, row["bytes"], signals)
        for data, values in row["values"].items():
            present = [(one, value) for one, value in zip(signals, values, strict=True) if value is not None]
            expected = {one.name: float(value) for one, value in present}
            are_in = [one.low <= value <= one.high for one, value in present if one.low or one.high]
            raw = bytes.fromhex(data)
            orders = int.from_bytes(raw, "little"), int.from_bytes(raw, "big")
            of_fields = {
                name: field.value(field.raw_value(*orders))
                for name, field in decoder.fields.items()
                if field.is_present(*orders)
            }
            assert of_fields == expected, (row["file"], row["frame"])
            assert unpacked(decoder, raw) == (expected if all(are_in) else None), (row["file"], row["frame"])
