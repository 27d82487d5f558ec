# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fuzz target on the CAN bus: any frame, with a good checksum or not."""

import math
from collections.abc import Callable

from fuzz_script import pieces, script
from trackslip_common.config_files import load_parameters
from trackslip_common.tally import Tally
from trackslip_drivers.can_parameters import DEFAULT_FILES, NODE, CanDriverParameters
from trackslip_drivers.protocols.can_frames import FrameDecoder, Rejection, load_frames
from trackslip_drivers.protocols.excavator_can import ExcavatorCan
from trackslip_drivers.records import SprocketSample
from trackslip_sim.devices.can_device import ENCODERS, PRESSURES, SPOOLS

Target = tuple[Callable[[bytes], None], list[bytes]]

CYCLE_NS = 10_000_000
NAMES = (ENCODERS, SPOOLS, PRESSURES)
SEALED = 4  # flag of a piece: its checksum is made good; the two bits below choose the frame


def can_frames() -> Target:
    """Decoder and pairing; a silence of any length may precede each frame."""
    p = load_parameters(CanDriverParameters, NODE, DEFAULT_FILES)
    frames = load_frames(p)
    ids = [frames.by_name[name].frame_id for name in NAMES]
    good = [frames.encode(ENCODERS, {"left_count": 7, "right_count": 8}, alive) for alive in (0, 1, 2)]

    def one_input(data: bytes) -> None:
        decoder = FrameDecoder(frames, Tally())
        can = ExcavatorCan(p, frames, Tally())
        now_ns = 0
        for kind, content in pieces(data):
            silence, payload = content[:2], content[2:]
            now_ns += 1_000_000 * int.from_bytes(silence, "little")
            chosen = kind & 3
            identifier = ids[chosen] if chosen < len(ids) else int.from_bytes(payload[:4], "big")
            codec = frames.find(identifier)
            if kind & SEALED and codec is not None and len(payload) == codec.length:
                payload = codec.sealed(identifier, payload)
            decoder.decode(identifier, payload, now_ns)
            for sample in can.receive(identifier, payload, now_ns):
                if isinstance(sample, SprocketSample):
                    assert math.isfinite(sample.left_velocity), sample
                    assert math.isfinite(sample.right_velocity), sample
        heard = [decoder.decode(*frame, now_ns + n * CYCLE_NS) for n, frame in enumerate(good, 1)]
        assert not any(isinstance(one, Rejection) for one in heard), heard
        assert heard[2], (
            "third frame held back"
        )  # the second may be, where a silence hides a turn of the counter

    alive = [frames.encode(ENCODERS, {"left_count": 9 * n, "right_count": 9 * n}, n)[1] for n in range(4)]
    spools = frames.encode(SPOOLS, {"left_spool": 0.5, "right_spool": -0.5}, 3)[1]
    values = {"left_pressure": 1e6, "right_pressure": 1e6, "supply_pressure": 1e7}
    pressures = frames.encode(PRESSURES, values, 3)[1]
    return one_input, [
        script(*((SEALED, b"\x0a\0" + payload) for payload in alive)),
        script((1, b"\x01\0" + spools), (2, b"\0\0" + pressures), (3, b"\0\0\x20\0\0\0")),
    ]


TARGETS = {can_frames.__name__: can_frames}
