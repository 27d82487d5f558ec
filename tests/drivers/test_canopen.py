# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""CANopen encoders: a DBC describes their PDOs; the driver starts the nodes."""

import pytest
from fixtures.unseen_bus import drive, machine

from trackslip_drivers.protocols.can_frames import STANDARD_FLAG
from trackslip_drivers.protocols.canopen import START_ALL, start_command

S = 1_000_000_000
DBC = """VERSION ""
BS_:
BU_: Left Right
BO_ 389 LeftPdo1: 4 Left
 SG_ Position : 0|32@1+ (1,0) [0|0] "counts" X
BO_ 390 RightPdo1: 4 Right
 SG_ Position : 0|32@1+ (1,0) [0|0] "counts" X
"""
ROLES = """roles:
  left_position: {signal: LeftPdo1.Position, counts_per_turn: 8192, wraps_at: 33554432}
  right_position: {signal: RightPdo1.Position, counts_per_turn: 8192, wraps_at: 33554432, sign: -1}
"""


def test_positions_of_encoders_are_sprockets_over_their_wrap(tmp_path):
    sent = []
    for k in range(100):
        counts = round(2.0 * 0.01 * k * 8192 / 6.283185307) - 200
        for identifier, sign in ((389, 1), (390, -1)):
            data = (sign * counts % 33554432).to_bytes(4, "little")
            sent.append((S + k * S // 100, identifier | STANDARD_FLAG, data))
    samples = drive(machine(tmp_path, ROLES, DBC), sent)
    assert len(samples) >= 95
    assert samples[-1][3:] == pytest.approx((2.0, 2.0), rel=0.01)  # rad/s
    turned = samples[-1].left_position - samples[0].left_position
    assert turned == pytest.approx(0.02 * (len(samples) - 1), abs=0.01)


@pytest.mark.parametrize(
    ("name", "data", "node"),
    [
        (0x705, b"\x00", 5),
        (0x77F, b"\x00", 127),
        (0x705, b"\x7f", 5),
        (0x705, b"\xff", 5),
        (0x705, b"\x05", None),
        (0x700, b"\x00", None),
        (0x705, b"", None),
        (0x705, b"\x00\x00", None),
        (0x185, b"\x00", None),
    ],
)
def test_node_in_bootup_or_preoperational_state_is_started(name, data, node):
    expected = None if node is None else (STANDARD_FLAG, bytes((1, node)))
    assert start_command(name | STANDARD_FLAG, data) == expected
    assert start_command(name, data) is None  # 29-bit identifier: not CANopen


def test_first_start_command_addresses_all_nodes():
    assert (STANDARD_FLAG, bytes((1, 0))) == START_ALL
