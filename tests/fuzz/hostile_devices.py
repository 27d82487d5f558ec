# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Readers of device logs for ``hostile_files.py``: a CAN bus in each format, a GNSS receiver."""

import zlib
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import can
from can.io import blf
from pyubx2 import GET, UBXMessage

from hostile_readers import Reader, importing
from trackslip_common.config_files import config_directory, load_parameters
from trackslip_drivers.can_parameters import DEFAULT_FILES, NODE, CanDriverParameters
from trackslip_drivers.protocols import nmea_sentences
from trackslip_drivers.protocols.can_frames import load_frames

WRITERS = {
    "candump": (can.CanutilsLogWriter, ".log"),
    "asc": (can.ASCWriter, ".asc"),
    "blf": (can.BLFWriter, ".blf"),
    "trc": (can.TRCWriter, ".trc"),
} | ({"mf4": (can.MF4Writer, ".mf4")} if find_spec("asammdf") else {})
_FRAMES = 40
_BEGIN_S = 1_790_000_000.0


def can_log(kind: str, folder: Path) -> Reader:
    """A log of our own CAN bus."""
    p = load_parameters(CanDriverParameters, NODE, DEFAULT_FILES)
    frames = load_frames(p)
    writer, suffix = WRITERS[kind]
    path = folder / f"seed{suffix}"
    with writer(path) as log:
        for k in range(_FRAMES):
            name = next(iter(frames.codecs))
            values = dict.fromkeys(frames.codecs[name].fields, 10.0 + k)
            identifier, data = frames.encode(name, values, k)
            stamp = _BEGIN_S + 0.01 * k
            log.on_message_received(
                can.Message(timestamp=stamp, arbitration_id=identifier, data=data, channel=0)
            )
    files = config_directory()
    mapping = f"can: {{dbc: {files / p.dbc_file}, roles: {files / p.roles_file}}}\n"
    log = path.read_bytes()
    return Reader([log], importing(folder, mapping), suffix, [_bomb(log)] if kind == "blf" else [])


def _bomb(log: bytes) -> bytes:
    """A BLF with containers that decompress to a thousand times their size; one object does not end."""
    whole = blf.OBJ_HEADER_BASE_STRUCT.pack(b"LOBJ", 16, 1, 1 << 31, 86) + bytes(1 << 28)
    packed = blf.LOG_CONTAINER_STRUCT.pack(blf.ZLIB_DEFLATE, 1 << 17) + zlib.compress(whole)
    head = blf.OBJ_HEADER_BASE_STRUCT.pack(b"LOBJ", 16, 1, 16 + len(packed), blf.LOG_CONTAINER)
    small = zlib.compress(whole[: 1 << 24])
    packed_small = blf.LOG_CONTAINER_STRUCT.pack(blf.ZLIB_DEFLATE, 1 << 17) + small
    head_small = blf.OBJ_HEADER_BASE_STRUCT.pack(b"LOBJ", 16, 1, 16 + len(packed_small), blf.LOG_CONTAINER)
    padding = bytes(len(head_small + packed_small) % 4)
    return log[:144] + (head_small + packed_small + padding) * 200 + head + packed


def receiver_log(kinds: str, folder: Path) -> Reader:
    """A receiver log of sentences, UBX messages, or both."""
    sentences, messages = b"", b""
    for k in range(20):
        at = nmea_sentences.Position(k * 10**8, 48.1, 11.6, 520.0, 4, 0.6, 0.01, 0.02, 90.0, 0.2)
        encoders = (nmea_sentences.gga, nmea_sentences.gst, nmea_sentences.rmc, nmea_sentences.pashr)
        sentences += b"".join(encode(at) for encode in encoders)
        fields = {"fixType": 3, "gnssFixOk": 1, "lat": 48.1, "lon": 11.6, "hAcc": 14, "vAcc": 20}
        day = {"year": 2026, "month": 11, "day": 25}
        messages += UBXMessage("NAV", "NAV-PVT", GET, iTOW=18_000 + 100 * k, **day, **fields).serialize()
    seeds = {"nmea": [sentences], "ubx": [messages], "both": [sentences + messages]}[kinds]
    return Reader(seeds, importing(folder, "gnss: {}\n"), ".nmea")


def trajectory(folder: Path) -> Reader:
    """A TUM trajectory of poses."""
    rows = [f"{_BEGIN_S + 0.1 * k:.3f} {0.1 * k:.2f} 0.5 0 0 0 0.1 0.995" for k in range(50)]
    pose = "{x: {column: tx, unit: m}, y: {column: ty, unit: m}, stddev: {x: 0.1, y: 0.1}}"
    mapping = "csv: {format: tum}\ntime: {column: timestamp, unit: s}\ntopics: {gnss_pose: " + pose + "}\n"
    return Reader(["\n".join(rows).encode()], importing(folder, mapping), ".txt")


READERS_OF_DEVICES: dict[str, Callable[[Path], Reader]] = {
    **{f"can_{kind}": partial(can_log, kind) for kind in WRITERS},
    **{f"receiver_{kinds}": partial(receiver_log, kinds) for kinds in ("nmea", "ubx", "both")},
    "trajectory": trajectory,
}
