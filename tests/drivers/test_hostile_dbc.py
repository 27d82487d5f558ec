# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A DBC with numbers that no CAN bus can have is refused before cantools processes it."""

from pathlib import Path

import pytest

from trackslip_common.errors import InputError
from trackslip_drivers.protocols.can_dbc import read_dbc

FRAME = "BO_ 1 F: 64 A\n"
PLAIN = ' SG_ S : 0|16@1+ (1,0) [0|0] "" A\n'


def nested(levels: int) -> str:
    """A DBC of nested multiplexers with two selectors each; cantools expands them to 2ⁿ nodes."""
    signals = [' SG_ M0 M : 0|1@1+ (1,0) [0|0] "" A\n']
    signals += [f' SG_ M{k} m0M : {k}|1@1+ (1,0) [0|0] "" A\n' for k in range(1, levels)]
    ranges = [f"SG_MUL_VAL_ 1 M{k} M{k - 1} 0-1;\n" for k in range(1, levels)]
    return FRAME + "".join(signals) + "".join(ranges)


def multiplexed(selectors: str) -> str:
    return (
        FRAME
        + ' SG_ M M : 0|16@1+ (1,0) [0|0] "" A\n SG_ S m0 : 16|8@1+ (1,0) [0|0] "" A\n'
        + f"SG_MUL_VAL_ 1 S M {selectors};\n"
    )


def chosen(count: int) -> str:
    """A DBC of two nested multiplexers with a name for each of ``count`` selectors."""
    words = " ".join(f'{k} "x"' for k in range(count))
    values = "".join(f"VAL_ 1 M{k} {words} ;\n" for k in range(2))
    signals = ' SG_ M0 M : 0|16@1+ (1,0) [0|0] "" A\n SG_ M1 m0M : 16|16@1+ (1,0) [0|0] "" A\n'
    return FRAME + signals + f"SG_MUL_VAL_ 1 M1 M0 0-{count - 1};\n" + values


HOSTILE = {
    "start bit": (
        FRAME + PLAIN.replace("0|16", "999999999|16"),
        "frame 'F': signal 'S': start bit 999999999",
    ),
    "start bit on a line of its own": (
        FRAME + PLAIN.replace("0|16", "\n 999999999 // x\n|\n16"),
        "start bit 999999999",
    ),
    "length": (FRAME + PLAIN.replace("0|16", "0|100000"), "length 100000; accepted: 1 to 14280"),
    "bytes of a frame": (
        FRAME.replace("64", "999999999") + PLAIN,
        "frame 'F' of 999999999 bytes; accepted: 0 to",
    ),
    "nested 30 times": (nested(30), "is nested too deep; accepted: up to 8"),
    "names for selectors": (chosen(200), "too many selectors of multiplexers"),
    "range": (multiplexed("0-4294967295"), "signal 'S': too many selectors"),
    "many ranges": (multiplexed(", ".join(f"{k}000-{k}999" for k in range(1, 40))), "too many selectors"),
    "exponent": (FRAME + PLAIN.replace("(1,", "(1E+999999,"), r"the number 1E\+999999 is too large"),
    "exponent in an attribute": (FRAME + PLAIN + 'BA_DEF_ BO_ "X" INT 0 1E+999999;\n', "is too large"),
    "digits": (FRAME + PLAIN.replace("0|0", "0|" + "9" * 5000), "a number of 5000 digits"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_numbers_of_no_can_bus_are_refused_before_cantools_has_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    def reached(*_: object, **__: object) -> None:
        pytest.fail("cantools has it")

    text, message = HOSTILE[name]
    path = tmp_path / "bus.dbc"
    path.write_text(text, encoding="utf-8")
    monkeypatch.setattr("cantools.database.load_string", reached)
    with pytest.raises(InputError, match=message) as caught:
        read_dbc(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        nested(6),
        multiplexed("0-9, 20-29"),
        FRAME + PLAIN.replace("0|0", "-1.7E+308|1.7E+308"),
        FRAME.replace("64", "1785") + PLAIN.replace("0|16", "14272|8"),
        FRAME + PLAIN + 'CM_ SG_ 1 S "SG_ S : 999999999|100000@1+ // 1E+999999";\n',
        "// BO_ 1 F: 999999999 A\n" + FRAME + PLAIN,
        (FRAME + PLAIN).replace(" S ", " E99999 "),
    ],
    ids=["nested", "ranges", "largest double", "of packets", "in a comment", "commented out", "in a name"],
)
def test_numbers_that_a_can_bus_has_are_read(tmp_path: Path, text: str) -> None:
    path = tmp_path / "bus.dbc"
    path.write_text(text, encoding="utf-8")
    assert len(read_dbc(path).database.messages) == 1


def test_file_of_another_kind_is_refused_whatever_its_suffix(tmp_path: Path) -> None:
    """cantools reads a file with this suffix as ARXML, whose XML entities may be nested."""
    path = tmp_path / "bus.arxml"
    path.write_text("<?xml version='1.0'?><AUTOSAR/>", encoding="utf-8")
    with pytest.raises(InputError, match="not a usable DBC"):
        read_dbc(path)
