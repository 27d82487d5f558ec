# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A log is known by its first bytes; one that no part of the mapping reads is named as what it is."""

from pathlib import Path
from typing import Any

import pytest
from fixtures.imports import refusal

from trackslip_bags.importing.log_kinds import LogKind, kind_of
from trackslip_drivers.protocols.nmea_sentences import Position, gga

GGA = gga(Position(0, quality=4))
KINDS: dict[bytes, tuple[LogKind, str]] = {  # content → kind, and words of the description
    b"(1790000000.000000) can0 18FEF100#1122334455667788\n": (LogKind.CAN, "candump"),
    b"date Wed Nov 25 12:00:00.000 2026\nbase hex  timestamps absolute\n": (LogKind.CAN, "ASC"),
    b"LOGG\x90\0\0\0": (LogKind.CAN, "BLF"),
    b"MDF     4.10    ": (LogKind.CAN, "MF4"),
    b";$FILEVERSION=2.1\n": (LogKind.CAN, "TRC"),
    GGA: (LogKind.GNSS, "NMEA"),
    b"\xb5\x62\x01\x07\x5c\0": (LogKind.GNSS, "UBX"),
    b"t,gz\n1,2\n": (LogKind.TABLE, "table"),
    b"": (LogKind.OTHER, "file without a byte"),
    bytes(range(256)) * 20: (LogKind.OTHER, "binary bytes"),  # a wrong line rate
    b"\xfe\xf8\xe0a" * 500: (LogKind.OTHER, "binary bytes"),
    b"MDF     3.30    " + bytes(200): (LogKind.OTHER, "MDF before version 4"),
    b"  can0  181   [4]  10 27 F0 D8\n" * 9: (LogKind.OTHER, "candump -L"),
    b" (1790000000.1)  can0  181   [4]  10 27 F0 D8\n" * 9: (LogKind.OTHER, "candump -L"),
    b" (2026-09-21 12:00:00.000000)  can0  181   [2]  10 27\n" * 9: (LogKind.OTHER, "candump -L"),
    b"Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2\n1,00000181,false,Rx,0,2,1,2\n": (LogKind.OTHER, "candump -L"),
    b"***BUSMASTER Ver 3.2.2***\n": (LogKind.OTHER, "candump -L"),
    b"t18121027\rt18121028\r": (LogKind.OTHER, "candump -L"),
    b" 0    00000181         2   16   39      0.020000 R\n": (LogKind.OTHER, "candump -L"),
    b"#BESTPOSA,COM1,0,55.0,FINESTEERING,2200,1.0,0,b1f6,1;SOL_COMPUTED\r\n" * 40: (LogKind.OTHER, "NovAtel"),
    (b"$@" + bytes(range(60))) * 40: (LogKind.OTHER, "SBF"),
    bytes.fromhex("d300133ed7d30202980edeef34b4bd62ac0941986f33360b98") * 40: (LogKind.OTHER, "RTCM"),
    GGA.hex(" ").encode() * 40: (LogKind.OTHER, "hex"),
    GGA[1:] * 40: (LogKind.OTHER, "without their $"),
    b"PK\x03\x04\x14\0": (LogKind.OTHER, "workbook of Excel"),
    b"\x1f\x8b\x08\0": (LogKind.OTHER, "packed file"),
}


@pytest.mark.parametrize("content", KINDS, ids=range(len(KINDS)))
def test_a_file_is_known_by_its_first_bytes(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.log").write_bytes(content)
    kind, description = kind_of(tmp_path / "x.log")
    assert kind is KINDS[content][0]
    assert KINDS[content][1] in description


TABLE = {
    "time": {"column": "t", "unit": "s"},
    "topics": {"swing": {"angle": {"column": "a", "unit": "rad"}}},
}


@pytest.mark.parametrize(
    ("content", "sections", "message"),
    [
        (b"LOGG\x90\0\0\0", TABLE, "a log of a CAN bus (BLF), no table; trackslip import reads it by 'can'"),
        (b"\x1f\x8b\x08\0", TABLE, "a packed file; unpack it; accepted: a CSV file"),
        (b"1,base_link,2\n2,base_link,2\n", TABLE, "line 1 holds values, and no line has names; accepted: "),
        (b't,a\n1,"2\n2,3\n', TABLE, "quote"),
        (b"", {"gnss": {}}, "x.log: a file without a byte"),
        (b"LOGG\x90\0\0\0", {"gnss": {}}, "x.log: a log of a CAN bus (BLF)"),
    ],
)
def test_a_file_that_no_part_of_the_mapping_reads_is_named(
    tmp_path: Path, content: bytes, sections: dict[str, Any], message: str
) -> None:
    (tmp_path / "x.log").write_bytes(content)
    assert message in refusal(tmp_path, tmp_path / "x.log", **sections)
