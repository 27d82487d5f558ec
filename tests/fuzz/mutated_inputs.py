# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Mutated messages of GNSS receivers, and mutated pairs of DBC and roles: part of ``make fuzz``.

Fields, bytes and lengths change; in seven of eight inputs the checksum matches the changed content.
Nothing raises anything but ``InputError``; results are finite; valid messages afterwards are read. A
finding prints its input and its traceback, and the exit code is 1.
"""

import argparse
import math
import random
import resource
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path

from pyubx2 import GET, UBXMessage, calc_checksum

from trackslip_common.config_files import config_directory, load_parameters
from trackslip_common.errors import InputError
from trackslip_common.tally import Tally
from trackslip_drivers.can_parameters import DEFAULT_FILES, NODE, CanDriverParameters
from trackslip_drivers.nmea_parameters import NmeaParameters
from trackslip_drivers.protocols import nmea_sentences
from trackslip_drivers.protocols.can_frames import STANDARD_FLAG, FrameSet
from trackslip_drivers.protocols.excavator_can import ExcavatorCan
from trackslip_drivers.protocols.gnss_frames import LONGEST_MESSAGE
from trackslip_drivers.protocols.nmea_stream import NmeaStream

COUNTS = {"nmea": 1_000_000, "ubx": 1_000_000, "dbc": 100_000}
MOST_MB = 1500
_MS = 1_000_000
_CHECK_INPUTS = 1000  # inputs between two checks with a valid fix
_MOST_FINDINGS = 10
_FIELDS = (
    *("", "0", "-0", "1e9", "nan", "inf", "-", ".", "9" * 40, "0x10", "1_0", "١٢", "4806.0", "60.0", "99"),
    *("235960.00", "240000", "N", "S", "E", "W", "T", "M", "A", "V", "D", "R", "U", "AANN", " 1", "1 ", "+1"),
)
_NUMBERS = (
    *("0", "-1", "1", "8", "63", "64", "65", "255", "1785", "1E308", "1e-308", "0.0", "-0", "2147483648"),
    *("4294967295", "18446744073709551615", "9" * 300, "nan", "m0", "M", "@", "|"),
)
AT = nmea_sentences.Position(1_200_000_000, -33.9, 151.2, 60.0, 4, 0.6, 0.01, 0.02, 123.0, 0.1)
_SENTENCES = (
    "GNHDT,123.0000,T",
    *(
        "GNGNS,101530.20,3352.1,S,15112.7,E,RR,18,0.6,41.20,22.10,1.0,0021,V",
        "GNVTG,12.0,T,,M,1.0,N,1.852,K,R",
    ),
    *("GNTHS,12.5,A", "PTNL,AVR,181059.6,149.4,Yaw,0.1,Tilt,,,60.2,3,2.5,6", "PSAT,HPR,1200.0,90.0,0,0,N"),
    "PSSN,HRP,142800.00,251126,8.3,,1.2,0.1,,0.2,12,2,3,E",
    "KSXT,20261125102155.00,116.3,40.1,59.3,12.5,0.1,2.0,0.5,,3,3,22,22,,,,-0.1,0.0,0.2,1,12,",
)
_HEADING = {"gnssFixOK": 1, "relPosValid": 1, "carrSoln": 2, "isMoving": 1, "relPosHeadingValid": 1}
_FIX = {"fixType": 3, "gnssFixOk": 1, "carrSoln": 2, "lat": 48.1, "lon": 11.6, "hAcc": 14, "vAcc": 20}
UBX_MESSAGES = (
    UBXMessage("NAV", "NAV-PVT", GET, iTOW=20_000, **_FIX),
    UBXMessage("NAV", "NAV-HPPOSLLH", GET, iTOW=20_000, lat=48.1, lon=11.6, hAcc=10.0, vAcc=15.0),
    UBXMessage("NAV", "NAV-COV", GET, iTOW=20_000, posCovValid=1, posCovNN=1e-4, posCovEE=1e-4),
    UBXMessage("NAV", "NAV-RELPOSNED", GET, version=1, iTOW=20_000, relPosHeading=30.0, **_HEADING),
)


class Receiver:
    """A receiver stream that gets mutated messages."""

    def __init__(self, seeds: list[bytes], mutate: Callable[[random.Random, bytes], bytes]) -> None:
        self._seeds, self._mutate = seeds, mutate
        self._stream = NmeaStream(load_parameters(NmeaParameters, "nmea_gnss", ("nmea_gnss.yaml",)), Tally())
        self._now_ns = self._count = 0

    def feed(self, draw: random.Random) -> None:
        """Process one input."""
        self._now_ns += draw.choice((0, 1, 40, 400)) * _MS
        content = self._mutate(draw, draw.choice(self._seeds))
        for sample in self._stream.feed(content, self._now_ns):
            assert all(math.isfinite(value) for value in sample[1:3]), sample
        assert self._stream.bytes_held <= LONGEST_MESSAGE
        self._count += 1
        if self._count % _CHECK_INPUTS == 0:
            self._check_valid_epoch()

    def _check_valid_epoch(self) -> None:
        """Assert that a valid epoch is read after a silence."""
        self._now_ns += 5000 * _MS
        self._stream.flush()
        later = AT._replace(time_ns=90_000_000_000 + self._now_ns % 10**12)
        output = b"\n" + nmea_sentences.gga(later) + nmea_sentences.gst(later)
        samples = self._stream.feed(output, self._now_ns) + self._stream.flush()
        assert any(abs(sample[1] + 33.9) < 1e-6 for sample in samples), samples


def nmea() -> Receiver:
    """A receiver of all supported NMEA sentences."""
    encoders = (nmea_sentences.gga, nmea_sentences.gst, nmea_sentences.rmc, nmea_sentences.pashr)
    seeds = [encode(AT)[1:].partition(b"*")[0] for encode in encoders]
    return Receiver([*seeds, *(text.encode() for text in _SENTENCES)], _mutated_sentence)


def ubx() -> Receiver:
    """A receiver of all supported UBX messages, and one that is not supported."""
    messages = (*UBX_MESSAGES, UBXMessage("MON", "MON-VER", GET))
    return Receiver([message.serialize()[2:-2] for message in messages], _mutated_message)


def _mutated_sentence(draw: random.Random, body: bytes) -> bytes:
    fields = body.decode().split(",")
    for _ in range(draw.choice((0, 1, 1, 2, 4))):
        at = draw.randrange(len(fields))
        put = draw.choice((draw.choice(_FIELDS), draw.choice(fields), fields[at][: draw.randrange(9)]))
        change = draw.randrange(4)
        fields[at : at + (change != 1)] = [] if change == 0 and len(fields) > 1 else [put]
    text = ",".join(fields)
    if draw.randrange(8) and text.isascii():
        return nmea_sentences.sentence(text)
    return _damaged(draw, b"$" + text.encode() + b"*00\r\n")


def _mutated_message(draw: random.Random, body: bytes) -> bytes:
    """A UBX message with mutated class, id, length and payload."""
    content = bytearray(body)
    for _ in range(draw.choice((0, 1, 2, 8))):
        at = draw.randrange(2 if draw.randrange(8) else 0, len(content))
        content[at] = draw.choice((0, 1, 0x7F, 0x80, 0xFF, draw.randrange(256)))
    if not draw.randrange(4):
        content = content[: draw.randrange(4, len(content) + 1)]
    if draw.randrange(8):
        content[2:4] = (len(content) - 4).to_bytes(2, "little")
        return b"".join((b"\xb5\x62", content, calc_checksum(bytes(content))))
    return _damaged(draw, b"\xb5\x62" + bytes(content) + calc_checksum(bytes(content)))


def _damaged(draw: random.Random, content: bytes) -> bytes:
    at, cut = draw.randrange(len(content)), draw.choice((0, 1, 4, 50))
    return content[:at] + draw.randbytes(draw.choice((0, 1, 4, 300))) + content[at + cut :]


class Bus:
    """A mutated DBC and roles, and frames that are decoded with them."""

    def __init__(self) -> None:
        self._p = load_parameters(CanDriverParameters, NODE, DEFAULT_FILES)
        files = config_directory()
        self._dbc = (files / self._p.dbc_file).read_text(encoding="utf-8")
        self._roles = (files / self._p.roles_file).read_text(encoding="utf-8")
        self._folder = Path(tempfile.mkdtemp(prefix="trackslip_mutated_"))

    def feed(self, draw: random.Random) -> None:
        """Process one pair, and some frames of each of its ids."""
        which = draw.randrange(3)
        dbc, roles = self._folder / "a.dbc", self._folder / "a.yaml"
        dbc.write_text(_mutated_text(draw, self._dbc) if which != 1 else self._dbc, encoding="utf-8")
        roles.write_text(_mutated_text(draw, self._roles) if which != 0 else self._roles, encoding="utf-8")
        try:
            frames = FrameSet(dbc, roles, self._p.vehicle)
        except InputError as error:
            refusal = str(error)
        else:
            refusal = ""
            self._receive(draw, frames)
        assert refusal.isprintable(), refusal

    def _receive(self, draw: random.Random, frames: FrameSet) -> None:
        bus = ExcavatorCan(self._p, frames, Tally())
        for k in range(6):
            for message in frames.by_name.values():
                flag = 0 if message.is_extended_frame else STANDARD_FLAG
                length = draw.choice((message.length, message.length, draw.randrange(65)))
                bus.receive(message.frame_id | flag, draw.randbytes(length), (100 + k) * 10 * _MS)


def _mutated_text(draw: random.Random, text: str) -> str:
    """Words and numbers changed, swapped, dropped or doubled."""
    words = text.split(" ")
    for _ in range(draw.choice((1, 1, 2, 4))):
        at = draw.randrange(len(words))
        other = draw.choice((draw.choice(words), draw.choice(_NUMBERS), words[at][: draw.randrange(5)], ""))
        change = draw.randrange(5)
        if change == 0:
            words[at : at + 1] = []
        elif change == 1:
            words.insert(at, other)
        else:
            digits = [k for k, c in enumerate(words[at]) if c.isdigit()]
            k = draw.choice(digits) if digits else 0
            words[at] = words[at][:k] + draw.choice(_NUMBERS) + words[at][k + 1 :] if digits else other
    return " ".join(words)


KINDS: dict[str, Callable[[], Receiver | Bus]] = {"nmea": nmea, "ubx": ubx, "dbc": Bus}


def main() -> int:
    """Run all kinds, or one; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kind", choices=KINDS, help="this one alone")
    parser.add_argument("--count", type=int, help="inputs of each kind (10^6, of DBCs 10^5)")
    parser.add_argument("--first", type=int, default=0, help="number of the first input (%(default)s)")
    args = parser.parse_args()
    found = [
        _run(kind, args.first, args.count or COUNTS[kind]) for kind in KINDS if args.kind in (None, kind)
    ]
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    print(f"{memory} MB")
    return int(any(found) or memory > MOST_MB)


def _run(kind: str, first: int, count: int) -> int:
    """Process inputs of one kind; return the number of findings."""
    began, found, target = time.monotonic(), 0, KINDS[kind]()
    for number in range(first, first + count):
        try:
            target.feed(random.Random(f"{kind} {number}"))
        except Exception:  # noqa: BLE001 (that is what is looked for)
            found += 1
            print(f"{kind} {number}:\n{traceback.format_exc()}", flush=True)
            if found == _MOST_FINDINGS:
                break
    print(f"{kind}: {number + 1 - first} inputs, {found} found, {time.monotonic() - began:.0f} s", flush=True)
    return found


if __name__ == "__main__":
    sys.exit(main())
