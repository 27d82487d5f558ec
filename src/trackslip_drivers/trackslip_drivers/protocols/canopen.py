# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""CANopen beside a DBC of its PDOs: starts nodes (CiA 301), as encoders (CiA 406) need.

000   01 node            NMT: start a node; node 0: all
700+node   00            boot-up: the node is powered, and waits for a start
"""

from trackslip_drivers.protocols.can_frames import STANDARD_FLAG

START_ALL = (STANDARD_FLAG, b"\x01\x00")

_ERROR_CONTROL, _NODES = 0x700, 0x7F
_BOOT_UP = b"\x00"
_PRE_OPERATIONAL = 0x7F  # state in a heartbeat


def start_command(arbitration_id: int, data: bytes) -> tuple[int, bytes] | None:
    """The frame that starts a waiting node; None if this frame reports no waiting node.

    Args:
        arbitration_id: in the transport's format.
        data: the payload.
    """
    node = arbitration_id & _NODES
    if arbitration_id & ~_NODES != _ERROR_CONTROL | STANDARD_FLAG or not node:
        return None
    waits = data == _BOOT_UP or (len(data) == 1 and data[0] & 0x7F == _PRE_OPERATIONAL)
    return (STANDARD_FLAG, bytes((1, node))) if waits else None
