# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Kind of a log by its first bytes: a table, a log of a CAN bus or of a GNSS receiver, or another file."""

import codecs
import re
from enum import Enum
from pathlib import Path

from trackslip_common.errors import InputError

_HEAD_SIZE = 4096  # bytes that are examined
_BYTE_ORDER_MARKS = {
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
    codecs.BOM_UTF8: "utf-8-sig",
}
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f\x7f]")
_HIGH = re.compile(rb"[\x80-\xff]")
_MOST_CONTROL, _MOST_HIGH = 0.02, 0.3  # of the bytes of a text


class LogKind(Enum):
    """Part of a mapping that reads a file."""

    CAN = "can"
    GNSS = "gnss"
    OTHER = ""  # a file that no part reads
    TABLE = "table"


_CANDUMP = rb"\s*\(\d+\.\d+\)\s+\S+\s+[0-9A-Fa-f]{3,8}#"
_CANDUMP_SCREEN = rb"\s*(?:\([-\d:. ]+\)\s+)?\S+\s+(?:[RT]X\s.*)?[0-9A-Fa-f]{3,8}\s+\[\d+\]\s"
_CAN_TABLE = rb"(?i)\"?time ?stamp\"?,\"?(?:id|arbitration_id)\"?,"
_OTHER_CAN = (
    rb"\*\*\*BUSMASTER|t[0-9A-Fa-f]{3}[0-8][0-9A-Fa-f]*\r"
    rb"|\s*\d+\s+[0-9A-Fa-f]{3,8}X?\s+[0-8]\s(?:\s*\d+)+\.\d+\s+[RT]\b"
)
_NMEA = rb"\s*\$(?:[A-Z]{5},|P[A-Z]{3,4}[,0-9]|KSXT,)"
_BASE64 = rb"\s*(?:JEd|JFB|tW[IJKL])[0-9A-Za-z+/\s]{60}"
_HEX = rb"\s*(?:0x)?(?:24|[bB]5)(?:[\s,:]*(?:0x)?[0-9A-Fa-f]{2}){30}"
_NOVATEL = rb"\s*[#%][A-Z0-9]+A,|\xaa\x44[\x12\x13\xb5]"
_SET_NMEA = "record NMEA with GGA, or UBX with NAV-PVT"
_SAVE_CAN = "save it as candump -L, ASC, BLF or TRC"
_AS_BYTES = "save its bytes"
_KINDS: tuple[tuple[bytes, LogKind, str], ...] = (
    (_CANDUMP, LogKind.CAN, "log of a CAN bus (candump)"),
    (_CANDUMP_SCREEN, LogKind.OTHER, "log of a CAN bus as candump shows it (record it with candump -L)"),
    (_CAN_TABLE, LogKind.OTHER, f"log of a CAN bus as CSV ({_SAVE_CAN})"),
    (_OTHER_CAN, LogKind.OTHER, f"log of a CAN bus ({_SAVE_CAN})"),
    (rb"LOGG", LogKind.CAN, "log of a CAN bus (BLF)"),
    (rb"(?:MDF  |UnFinMF )[^\0]{3}[0-3]", LogKind.OTHER, "MDF before version 4 (save it as MF4)"),
    (rb"(?:MDF |UnFinMF)", LogKind.CAN, "log of a CAN bus (MF4)"),
    (rb"\s*(?:;[^\n]*\n)*(?:;\$FILEVERSION|\s*1\)\s+\d)", LogKind.CAN, "log of a CAN bus (TRC)"),
    (rb"(?:date [^\n]*\n|\s*//[^\n]*\n)*\s*base\s+(?:hex|dec)", LogKind.CAN, "log of a CAN bus (ASC)"),
    (_NOVATEL, LogKind.OTHER, f"log of NovAtel or Unicore messages ({_SET_NMEA})"),
    (rb"\s*G[A-Z](?:GGA|RMC|GSV|GLL|VTG|GSA|ZDA),", LogKind.OTHER, "log of NMEA sentences without their $"),
    (_BASE64, LogKind.OTHER, f"receiver's log as base64 ({_AS_BYTES})"),
    (_HEX, LogKind.OTHER, f"receiver's log as hex ({_AS_BYTES})"),
    (_NMEA, LogKind.GNSS, "log of a GNSS receiver (NMEA)"),
    (rb"\xb5\x62", LogKind.GNSS, "log of a GNSS receiver (UBX)"),
    (rb"\$@[^\0-\x1f]|\$@[\s\S]{6}", LogKind.OTHER, f"log of Septentrio, SBF ({_SET_NMEA})"),
    (rb"\xd3[\0-\3]", LogKind.OTHER, f"log of RTCM corrections ({_SET_NMEA})"),
    (rb" {5}[2-4]\.\d\d {11}", LogKind.OTHER, f"RINEX file ({_SET_NMEA})"),
    (rb"\x89MCAP|SQLite format 3\0", LogKind.OTHER, "bag of ROS 2, which topics with 'from' read"),
    (rb"#ROSBAG", LogKind.OTHER, "bag of ROS 1, which topics with 'from' read"),
    (rb"PK\x03\x04", LogKind.OTHER, "ZIP file or workbook of Excel; save its sheet as CSV"),
    (rb"\x1f\x8b|BZh|\xfd7zXZ|\x28\xb5\x2f\xfd", LogKind.OTHER, "packed file; unpack it"),
    (rb"PAR1", LogKind.OTHER, "Parquet file; save it as CSV"),
    (rb"\xd4\xc3\xb2\xa1|\xa1\xb2\xc3\xd4|\n\r\r\n", LogKind.OTHER, "capture of a network; save its payload"),
    (rb"\s*[\[{]\s*[\"{]", LogKind.OTHER, "JSON file; save it as CSV"),
    (rb"%PDF|\x89PNG|\xff\xd8\xff", LogKind.OTHER, "document or picture"),
)


def kind_of(path: Path) -> tuple[LogKind, str]:
    """The kind of a file, and its description in words.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        first = file.read(_HEAD_SIZE).rstrip(b"\0")
    if not first.strip():
        is_empty = not path.stat().st_size
        return LogKind.OTHER, "file without a byte" if is_empty else "file of blanks or zero bytes"
    mark = encoding_of_mark(first)
    text = first.decode(mark, "ignore").encode("latin-1", "replace") if mark else first
    for pattern, kind, description in _KINDS:
        if re.match(pattern, text):
            return kind, description
    if _is_binary(text):
        return (
            LogKind.OTHER,
            "file of binary bytes (a receiver at a wrong line rate, or a kind that is not read)",
        )
    return LogKind.TABLE, "table"


def encoding_of_mark(first: bytes) -> str:
    """The encoding by the byte order mark of a text; empty where it has none."""
    return next((name for mark, name in _BYTE_ORDER_MARKS.items() if first.startswith(mark)), "")


def utf16_without_mark(first: bytes) -> str:
    """The encoding of a text with about half of its bytes zero, by their positions; empty for other texts."""
    even, odd = (first[k::2].count(0) for k in (0, 1))
    if not max(even, odd) > len(first) // 4 > min(even, odd):
        return ""
    return "utf-16-le" if odd > even else "utf-16-be"


def _is_binary(first: bytes) -> bool:
    if utf16_without_mark(first):
        first = first.replace(b"\0", b"")
    if len(_CONTROL.findall(first)) > _MOST_CONTROL * len(first):
        return True
    try:
        first[: len(first) - 4].decode("utf-8")
    except UnicodeDecodeError:
        return len(_HIGH.findall(first)) > _MOST_HIGH * len(first)
    return False


def require_table(path: Path) -> None:
    """Accept a table only.

    Raises:
        InputError: it is of another kind; names the kind, and the part of the mapping that reads it.
        OSError: it cannot be read.
    """
    kind, description = kind_of(path)
    if kind in (LogKind.CAN, LogKind.GNSS):
        raise InputError(
            f"{path}: a {description}, no table; trackslip import reads it by '{kind.value}' in the mapping "
            "(docs/import.md)"
        )
    if kind is LogKind.OTHER:
        raise InputError(f"{path}: a {description}; accepted: a CSV file")
