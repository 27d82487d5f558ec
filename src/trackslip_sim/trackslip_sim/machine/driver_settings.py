# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the drivers, which the emulated devices share with them."""

from typing import NamedTuple, TypeVar

from trackslip_common.config_files import load_parameters
from trackslip_common.parameters import Parameters
from trackslip_drivers import can_parameters
from trackslip_drivers.can_parameters import CanDriverParameters
from trackslip_drivers.nmea_parameters import NmeaParameters
from trackslip_drivers.protocols.can_frames import FrameSet, load_frames
from trackslip_drivers.protocols.watson import Layout
from trackslip_drivers.sick_parameters import SickParameters
from trackslip_drivers.watson_parameters import WatsonParameters

T = TypeVar("T", bound=Parameters)


class DriverSettings(NamedTuple):
    """Parameters of each driver, and the formats that follow from them."""

    can: CanDriverParameters
    frames: FrameSet
    watson: WatsonParameters
    layout: Layout
    sick: SickParameters
    nmea: NmeaParameters


def default_drivers() -> DriverSettings:
    """The drivers' defaults in ``config/``."""
    can = default_parameters(CanDriverParameters, can_parameters.NODE, *can_parameters.DEFAULT_FILES)
    watson = default_parameters(WatsonParameters, "watson_imu")
    layout = Layout(watson.channels, watson.formats, watson.full_scales)
    sick = default_parameters(SickParameters, "sick_pls")
    nmea = default_parameters(NmeaParameters, "nmea_gnss")
    return DriverSettings(can, load_frames(can), watson, layout, sick, nmea)


def default_parameters(cls: type[T], node: str, *files: str) -> T:
    """Default parameters of a node from ``files`` in ``config/``, by default ``<node>.yaml``."""
    return load_parameters(cls, node, files or (f"{node}.yaml",))
