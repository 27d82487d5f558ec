# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the node ``nmea_gnss`` (values: ``config/nmea_gnss.yaml``)."""

import re
from dataclasses import dataclass

from trackslip_common.errors import InputError
from trackslip_common.parameters import Parameters, parameter
from trackslip_drivers.serial_parameters import SerialParameters


@dataclass(frozen=True, kw_only=True)
class RangeErrors(Parameters):
    """Range errors, used without a GST: σ_E = σ_N = HDOP · error/√2, σ_U = 2 σ_E."""

    single: float = parameter("range error of code measurements alone", unit="m", gt=0.0)
    differential: float = parameter("range error with corrections", unit="m", gt=0.0)
    rtk_float: float = parameter("range error of carrier phase, ambiguities not fixed", unit="m", gt=0.0)
    rtk_fixed: float = parameter("range error of carrier phase, ambiguities fixed", unit="m", gt=0.0)


@dataclass(frozen=True, kw_only=True)
class NtripParameters(Parameters):
    """Source of GNSS corrections."""

    host: str = parameter("host of the caster; empty: the node passes no corrections to the receiver")
    port: int = parameter("port of the caster", gt=0, le=65535)
    tls: bool = parameter("whether the connection uses TLS")
    mountpoint: str = parameter("mountpoint of an RTCM 3 stream; letters, digits, '_', '-' and '.'")
    credentials_file: str = parameter(
        "file of two lines, user and password, of mode 0600; empty: no authentication"
    )
    gga_interval: float = parameter(
        "time between positions sent to the caster, for local corrections; 0: none", unit="s", ge=0.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.host and not re.fullmatch(r"[\w.-]+", self.mountpoint, re.ASCII):
            raise InputError(
                f"nmea_gnss: ntrip.mountpoint: '{self.mountpoint}' is refused; accepted: letters, digits, _-."
            )
        if self.host and not re.fullmatch(r"[\w.:-]+", self.host, re.ASCII):
            raise InputError(
                f"nmea_gnss: ntrip.host: '{self.host}' is refused; accepted: a name or an address"
            )


@dataclass(frozen=True, kw_only=True)
class NmeaParameters(SerialParameters):
    """Port, times, and accuracies where the receiver states none."""

    frame_id: str = parameter("frame of the antenna whose position is published")
    heading_frame_id: str = parameter("frame of the antenna pair")
    rate: float = parameter("rate of fixes that the receiver is set to", unit="Hz", gt=0.0, le=100.0)
    latency: float = parameter(
        "shortest time from a fix to the first byte that reports it",
        unit="s",
        ge=0.0,
        lt=1.0,
    )
    host_clock_is_utc: bool = parameter(
        "whether the host's clock is kept on UTC to a millisecond (PTP, PPS): fixes are then stamped with the"
        " receiver's own time, and no latency is assumed"
    )
    heading_stddev: float = parameter(
        "noise of a heading without a stated accuracy; 0: unknown", unit="rad", ge=0.0
    )
    velocity_stddev: float = parameter(
        "noise of a velocity without a stated accuracy, east and north; 0: unknown", unit="m/s", ge=0.0
    )
    range_errors: RangeErrors
    ntrip: NtripParameters
