# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the node ``gnss_localizer`` (values: ``config/gnss_localizer.yaml``)."""

from dataclasses import dataclass

from trackslip_common.errors import InputError
from trackslip_common.parameters import Parameters, parameter

NODE = "gnss_localizer"
HIGHEST_LATITUDE = 89.0  # ° of a datum: east and north are undefined at a pole


@dataclass(frozen=True, kw_only=True)
class AssumedStddevs(Parameters):
    """Standard deviation, east and north, of a fix whose covariance is unknown; by its status."""

    single: float = parameter("status FIX: code alone", unit="m", gt=0.0)
    differential: float = parameter("status SBAS_FIX: code with corrections", unit="m", gt=0.0)
    rtk: float = parameter(
        "status GBAS_FIX: corrections from a base; fixed or float is unknown", unit="m", gt=0.0
    )


@dataclass(frozen=True, kw_only=True)
class GnssLocalizerParameters(Parameters):
    """Origin of the map, and limits of accepted fixes."""

    map_frame: str = parameter("frame of the poses: x east, y north of the datum")
    datum_latitude: float = parameter(
        "latitude of the map's origin; 0, 0: the first good fix, a different one after each start",
        unit="°",
        ge=-90.0,
        le=90.0,
    )
    datum_longitude: float = parameter("longitude of the map's origin", unit="°", ge=-180.0, le=180.0)
    datum_altitude: float = parameter(
        "altitude of the map's origin above the ellipsoid", unit="m", ge=-1e4, le=1e5
    )
    datum_fixes: int = parameter(
        "consecutive fixes that agree before the first of them is the datum", ge=1, le=1000
    )
    max_distance: float = parameter("fixes farther from the datum are rejected", unit="m", gt=0.0, le=1e6)
    max_stddev: float = parameter(
        "fixes with a larger standard deviation, east or north, are rejected", unit="m", gt=0.0
    )
    assumed_stddev: AssumedStddevs

    def __post_init__(self) -> None:
        """Check each field, then that the datum is not near a pole.

        Raises:
            InputError: a value is out of range.
        """
        super().__post_init__()
        if abs(self.datum_latitude) > HIGHEST_LATITUDE:
            raise InputError(
                f"GnssLocalizerParameters.datum_latitude: {self.datum_latitude:g} is out of range;"
                " accepted: >= -89 and <= 89 °, east and north are undefined at a pole"
            )

    @property
    def has_datum(self) -> bool:
        """Whether the map's origin is given by parameters."""
        return self.datum_latitude != 0.0 or self.datum_longitude != 0.0
