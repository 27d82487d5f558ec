# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the node ``nmea_gnss`` (values: ``config/nmea_gnss.yaml``)."""

import re
from dataclasses import dataclass

from trackslip_common.errors import InputError
from trackslip_common.parameters import Parameters, parameter


@dataclass(frozen=True, kw_only=True)
class RangeErrors(Parameters):
    """What HDOP is multiplied with where there is no GST: σ_E = σ_N = HDOP · error/√2, σ_U = 2 σ_E."""

    single: float = parameter("error of a range, code alone", unit="m", gt=0.0)
    differential: float = parameter("the same with corrections", unit="m", gt=0.0)
    rtk_float: float = parameter("the same of carrier phase, ambiguities not fixed", unit="m", gt=0.0)
    rtk_fixed: float = parameter("the same with ambiguities fixed", unit="m", gt=0.0)


@dataclass(frozen=True, kw_only=True)
class NtripParameters(Parameters):
    """Where corrections come from."""

    host: str = parameter("caster; empty: the receiver gets no corrections from here")
    port: int = parameter("its port", gt=0, le=65535)
    tls: bool = parameter("whether it is spoken to over TLS")
    mountpoint: str = parameter("stream of RTCM 3; letters, digits, '_', '-' and '.'")
    credentials_file: str = parameter(
        "file of two lines, user and password, of mode 0600; empty: the caster wants none"
    )
    gga_interval: float = parameter(
        "between positions that it is sent, for corrections made for a place; 0: none", unit="s", ge=0.0
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
class NmeaParameters(Parameters):
    """Port, times, and how far the receiver can be trusted where it does not say so."""

    serial_port: str = parameter("device path or pyserial URL, such as socket://192.168.0.5:5017")
    serial_baud: int = parameter("line rate; without meaning on a network", unit="baud", gt=0)
    parity: str = parameter("parity of the line: N none, E even, O odd", choices=("N", "E", "O"))
    frame_id: str = parameter("frame of the antenna whose position is sent")
    heading_frame_id: str = parameter("frame of the antenna pair")
    rate: float = parameter("fixes that the receiver was set to send", unit="Hz", gt=0.0, le=100.0)
    time_offset: float = parameter("added to every stamp", unit="s")
    latency: float = parameter(
        "from the moment of a fix to the first byte that reports it, at its shortest",
        unit="s",
        ge=0.0,
        lt=1.0,
    )
    host_clock_is_utc: bool = parameter(
        "whether the host's clock is kept on UTC to a millisecond (PTP, PPS): then a fix is stamped with the"
        " receiver's own time, and no latency is assumed"
    )
    heading_stddev: float = parameter(
        "noise of a heading that comes without one; 0: unknown", unit="rad", ge=0.0
    )
    velocity_stddev: float = parameter(
        "noise of a velocity that comes without one, east and north; 0: unknown", unit="m/s", ge=0.0
    )
    range_errors: RangeErrors
    ntrip: NtripParameters
