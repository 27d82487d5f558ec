# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of every driver of a device on a serial line."""

from dataclasses import dataclass

from trackslip_common.parameters import Parameters, parameter


@dataclass(frozen=True, kw_only=True)
class SerialParameters(Parameters):
    """The line, and the delay of what comes over it."""

    serial_port: str = parameter("device path or pyserial URL, such as socket://192.168.0.5:5017")
    serial_baud: int = parameter("line rate; unused on a network", unit="Bd", gt=0)
    parity: str = parameter("parity of the line: N none, E even, O odd", choices=("N", "E", "O"))
    time_offset: float = parameter("added to every stamp", unit="s")
