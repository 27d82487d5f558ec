# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""State of a CAN bus from the error frames of its controller (classes and bits of Linux' can/error.h)."""

from enum import Enum

_CONTROLLER_CLASS = 0x004  # class in the id: details in the second byte
_BUS_OFF_CLASS = 0x040
_RESTARTED_CLASS = 0x100


class BusState(Enum):
    """Error state of the CAN controller."""

    ACTIVE = "active"
    WARNING = "warning: many errors"
    PASSIVE = "passive: too many errors"
    OFF = "off"


_DETAILS = ((0x30, BusState.PASSIVE), (0x0C, BusState.WARNING), (0x40, BusState.ACTIVE))  # worst first


def bus_state(arbitration_id: int, data: bytes) -> BusState | None:
    """The state that an error frame reports; None where it reports none."""
    if arbitration_id & _BUS_OFF_CLASS:
        return BusState.OFF
    if arbitration_id & _RESTARTED_CLASS:
        return BusState.ACTIVE
    detail = data[1] if arbitration_id & _CONTROLLER_CLASS and len(data) > 1 else 0
    return next((state for bits, state in _DETAILS if detail & bits), None)
