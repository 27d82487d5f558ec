# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Positions on the Earth as east and north of a datum (WGS84)."""

import math

import numpy as np
import pymap3d
from numpy.typing import NDArray

from trackslip_bags.importing.mapping import Datum

FloatArray = NDArray[np.float64]


class LocalFrame:
    """East and north of a datum: of the one that is given, or of the first position asked for."""

    def __init__(self, datum: Datum | None) -> None:
        self.datum = datum

    def east_north(self, place: FloatArray) -> FloatArray:
        """(n, 2) m of (n, 3) latitude and longitude, rad, and altitude, m (nan: that of the datum)."""
        if self.datum is None:
            latitude, longitude, altitude = place[0].tolist()
            altitude = altitude if math.isfinite(altitude) else 0.0
            self.datum = Datum(math.degrees(latitude), math.degrees(longitude), altitude)
        degrees = np.degrees(place[:, :2])
        altitudes = np.where(np.isnan(place[:, 2]), self.datum.altitude, place[:, 2])
        east, north, _ = pymap3d.geodetic2enu(degrees[:, 0], degrees[:, 1], altitudes, *self.datum)
        return np.column_stack((east, north))
