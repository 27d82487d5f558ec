# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Entry points of the drivers; each loads its module only when called (see ``start``)."""

from trackslip_common.start import start


def can_driver() -> None:
    """See ``trackslip_drivers.nodes.can_driver``."""
    start("trackslip_drivers.nodes.can_driver")


def watson_imu() -> None:
    """See ``trackslip_drivers.nodes.watson_imu``."""
    start("trackslip_drivers.nodes.watson_imu")


def sick_pls() -> None:
    """See ``trackslip_drivers.nodes.sick_pls``."""
    start("trackslip_drivers.nodes.sick_pls")


def nmea_gnss() -> None:
    """See ``trackslip_drivers.nodes.nmea_gnss``."""
    start("trackslip_drivers.nodes.nmea_gnss")


def wheel_adapter() -> None:
    """See ``trackslip_drivers.nodes.wheel_adapter``."""
    start("trackslip_drivers.nodes.wheel_adapter")
