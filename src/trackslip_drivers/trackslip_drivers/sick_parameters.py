# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the node ``sick_pls`` (values: ``config/sick_pls.yaml``)."""

from dataclasses import dataclass

from trackslip_common.errors import InputError
from trackslip_common.parameters import parameter
from trackslip_drivers.protocols.sick_commands import BAUD_CODES
from trackslip_drivers.serial_parameters import SerialParameters


@dataclass(frozen=True, kw_only=True)
class SickParameters(SerialParameters):
    """Properties of a scanner, and of the line to it."""

    serial_baud: int = parameter(
        "rate that the scanner is switched to; if it refuses, the next lower", unit="Bd", gt=0
    )
    frame_id: str = parameter("frame of the scan")
    model: str = parameter("kind of scanner", choices=("pls", "lms"))
    clockwise: bool = parameter("whether the scanner hangs upside down, so that its rays run clockwise")
    range_min: float = parameter("shorter ranges are 'too close' (-inf)", unit="m", ge=0.0)
    range_max: float = parameter("longer ranges are 'no return' (+inf)", unit="m", gt=0.0)
    glare_is_nan: bool = parameter("whether a ray with the glare flag is invalid (NaN)")
    scan_time: float = parameter("one turn of the mirror", unit="s", gt=0.0)
    ack_timeout: float = parameter("longest wait for an acknowledgement", unit="s", gt=0.0)
    mode_timeout: float = parameter("longest wait for a change of mode", unit="s", gt=0.0)
    baud_pause: float = parameter("silence after a change of rate", unit="s", ge=0.0)
    telegram_timeout: float = parameter(
        "time without a scan after which the start-up is repeated", unit="s", gt=0.0
    )
    silence_timeout: float = parameter(
        "time without a byte during streaming after which the start-up is repeated", unit="s", gt=0.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.serial_baud not in BAUD_CODES:
            rates = ", ".join(str(rate) for rate in sorted(BAUD_CODES))
            raise InputError(f"SickParameters.serial_baud: {self.serial_baud} is not one of {rates}")
        if self.range_min >= self.range_max:
            accepted = f"accepted: below range_max = {self.range_max:g} m"
            raise InputError(f"SickParameters.range_min: {self.range_min:g} m; {accepted}")

    @property
    def bits_per_char(self) -> int:
        """Bits of a character: start, eight data, parity if there is one, stop."""
        return 10 if self.parity == "N" else 11
