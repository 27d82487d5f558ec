# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Readers of logs of devices for ``hostile_files.py``: of a CAN bus in each format, of a GNSS receiver."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import can
from pyubx2 import GET, UBXMessage

from hostile_readers import Reader, remove
from trackslip_common.config_files import config_directory, load_parameters
from trackslip_drivers.can_parameters import DEFAULT_FILES, NODE, CanDriverParameters
from trackslip_drivers.protocols import nmea_sentences
from trackslip_drivers.protocols.can_frames import load_frames
from trackslip_tools.cli.main import main

WRITERS = {
    "candump": (can.CanutilsLogWriter, ".log"),
    "asc": (can.ASCWriter, ".asc"),
    "blf": (can.BLFWriter, ".blf"),
    "trc": (can.TRCWriter, ".trc"),
}
_FRAMES = 40
_BEGIN_S = 1_790_000_000.0


def _read(folder: Path, mapping: str, path: Path) -> int:
    (folder / "mapping.yaml").write_text(mapping, encoding="utf-8")
    options = ["--mapping", str(folder / "mapping.yaml"), "--output", str(folder / "bag")]
    code = main(["import", str(path), *options])
    remove(folder / "bag")
    return code


def can_log(kind: str, folder: Path) -> Reader:
    """A log of our own bus."""
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
    return Reader([path.read_bytes()], partial(_read, folder, mapping), suffix)


def receiver_log(folder: Path) -> Reader:
    """Sentences and UBX messages of a receiver."""
    sentences, messages = b"", b""
    for k in range(20):
        at = nmea_sentences.Position(k * 10**8, 48.1, 11.6, 520.0, 4, 0.6, 0.01, 0.02, 90.0, 0.2)
        encoders = (nmea_sentences.gga, nmea_sentences.gst, nmea_sentences.rmc, nmea_sentences.pashr)
        sentences += b"".join(encode(at) for encode in encoders)
        fields = {"fixType": 3, "gnssFixOk": 1, "lat": 48.1, "lon": 11.6, "hAcc": 14, "vAcc": 20}
        day = {"year": 2026, "month": 11, "day": 25}
        messages += UBXMessage("NAV", "NAV-PVT", GET, iTOW=18_000 + 100 * k, **day, **fields).serialize()
    return Reader([sentences, messages, sentences + messages], partial(_read, folder, "gnss: {}\n"), ".nmea")


READERS_OF_DEVICES: dict[str, Callable[[Path], Reader]] = {
    **{f"can_{kind}": partial(can_log, kind) for kind in WRITERS},
    "receiver_log": receiver_log,
}
