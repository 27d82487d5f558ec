# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Entry points of the drivers; each loads its module only when called (see ``start``)."""

from functools import partial

from trackslip_common.start import start

can_driver = partial(start, "trackslip_drivers.nodes.can_driver")
watson_imu = partial(start, "trackslip_drivers.nodes.watson_imu")
sick_pls = partial(start, "trackslip_drivers.nodes.sick_pls")
nmea_gnss = partial(start, "trackslip_drivers.nodes.nmea_gnss")
wheel_adapter = partial(start, "trackslip_drivers.nodes.wheel_adapter")
