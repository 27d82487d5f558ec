# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Multiplexers in multiplexers: what a payload holds is what cantools finds in it."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from cantools.database.errors import DecodeError
from hypothesis import given
from hypothesis import strategies as st

from trackslip_drivers.protocols.can_codec import Codec, Protection
from trackslip_drivers.protocols.can_dbc import read_dbc

FRAME_BYTES = 8


class Selected(NamedTuple):
    """A signal, the multiplexer above it, and the ranges of that which select it."""

    name: str
    is_multiplexer: bool
    start: int
    bits: int
    above: str = ""
    ranges: tuple[tuple[int, int], ...] = ()

    def lines(self) -> Iterator[str]:
        """Of the DBC: the signal, and its selectors."""
        mark = f" m{self.ranges[0][0]}" if self.above else ""
        mark += ("M" if self.above else " M") if self.is_multiplexer else ""
        yield f' SG_ {self.name}{mark} : {self.start}|{self.bits}@1+ (1,0) [0|0] "" X'
        ranges = ",".join(f"{low}-{high}" for low, high in self.ranges)
        yield f"SG_MUL_VAL_ 1 {self.name} {self.above} {ranges};" if self.above else ""


@st.composite
def trees(draw: st.DrawFn) -> list[Selected]:
    """Up to three multiplexers in each other, of two bits each, and signals below them."""
    depth = draw(st.integers(1, 3))
    signals = [Selected("M0", True, 0, 2)]
    ranges = st.sampled_from([((0, 0),), ((1, 1),), ((2, 3),), ((0, 0), (3, 3)), ((1, 2),)])
    for k in range(1, depth):
        signals.append(Selected(f"M{k}", True, 2 * k, 2, f"M{k - 1}", draw(ranges)))
    for k in range(draw(st.integers(1, 6))):
        above = f"M{draw(st.integers(0, depth - 1))}"
        signals.append(Selected(f"S{k}", False, 8 + 8 * k, 8, above, draw(ranges)))
    return signals


def dbc(signals: list[Selected]) -> str:
    lines = [tuple(signal.lines()) for signal in signals]
    frame = "\n".join(["BO_ 1 Frame: 8 X", *(signal for signal, _ in lines)])
    return f'VERSION ""\nBS_:\nBU_: X\n{frame}\n\n' + "\n".join(
        selectors for _, selectors in lines if selectors
    )


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("dbc") / "bus.dbc"


@given(trees(), st.lists(st.binary(min_size=FRAME_BYTES, max_size=FRAME_BYTES), min_size=1, max_size=20))
def test_a_signal_is_there_only_if_its_whole_chain_of_selectors_is(
    path: Path, signals: list[Selected], payloads: list[bytes]
) -> None:
    path.write_text(dbc(signals), encoding="utf-8")
    (message,) = read_dbc(path).database.messages
    codec = Codec(message, [signal.name for signal in signals], (), Protection())
    for data in payloads:
        try:
            expected = message.decode(data, decode_choices=False)
        except DecodeError:  # a selector that selects nothing
            continue
        found = codec.unpack(int.from_bytes(data, "little"), int.from_bytes(data, "big"))
        assert found == expected
