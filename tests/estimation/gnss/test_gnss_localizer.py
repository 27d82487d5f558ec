# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fixes in the map frame: metric accuracy anywhere on earth, and each reason for a rejection."""

import math

import numpy as np
import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackslip_bags.messages import make
from trackslip_common.config_files import node_defaults
from trackslip_common.errors import InputError
from trackslip_common.parameters import from_flat
from trackslip_estimation.gnss.conversions import pose
from trackslip_estimation.gnss.localizer import AntennaPosition, Datum, Fix, GnssLocalizer, Reason
from trackslip_estimation.gnss.parameters import NODE, GnssLocalizerParameters
from trackslip_estimation.slip.measurements import UNOBSERVED

DATUM = {"datum_latitude": -33.889, "datum_longitude": 151.193, "datum_altitude": 60.0}
COVARIANCE = np.diag((0.01**2, 0.02**2))


def localizer(**parameters):
    return GnssLocalizer(
        from_flat(GnssLocalizerParameters, node_defaults(NODE, f"{NODE}.yaml") | parameters, NODE)
    )


UP = 0.04**2  # m²


def fix(latitude=-33.889, longitude=151.193, altitude=60.0, status=2, covariance=COVARIANCE, kind=2, up=UP):
    return Fix(17, latitude, longitude, altitude, status, np.asarray(covariance, dtype=float), kind, up)


@given(
    st.floats(-88.0, 88.0),
    st.floats(-180.0, 180.0),
    st.floats(-50.0, 4000.0),
    st.tuples(st.floats(-3000.0, 3000.0), st.floats(-3000.0, 3000.0), st.floats(-300.0, 300.0)),
)
def test_position_is_metres_east_north_and_up(latitude, longitude, altitude, at):
    if latitude == longitude == 0.0:
        return
    there = pymap3d.enu2geodetic(*at, latitude, longitude, altitude)
    gnss = localizer(datum_latitude=latitude, datum_longitude=longitude, datum_altitude=altitude)
    position = gnss.locate(fix(*map(float, there)))
    assert isinstance(position, AntennaPosition)
    assert (position.east, position.north, position.up) == pytest.approx(at, abs=1e-5)
    np.testing.assert_array_equal(position.covariance, COVARIANCE)
    assert position.up_variance == UP


def test_unknown_altitude_is_that_of_the_datum():
    position = localizer(**DATUM).locate(fix(-33.888, 151.194, math.nan))
    assert isinstance(position, AntennaPosition)
    same = localizer(**DATUM).locate(fix(-33.888, 151.194, 60.0))
    assert (position.east, position.north) == pytest.approx((same.east, same.north), abs=1e-3)
    assert math.isnan(position.up)
    message = pose(make, position, "gnss_pose", "map")
    assert (message.pose.pose.position.z, message.pose.covariance[14]) == (0.0, UNOBSERVED)


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"status": -1}, Reason.NO_FIX),
        ({"latitude": math.nan}, Reason.NOT_A_NUMBER),
        ({"longitude": math.inf}, Reason.NOT_A_NUMBER),
        ({"altitude": -math.inf}, Reason.NOT_A_NUMBER),
        ({"latitude": 0.0, "longitude": 0.0}, Reason.ZERO),
        ({"latitude": -91.0}, Reason.OUT_OF_RANGE),
        ({"longitude": 200.0}, Reason.OUT_OF_RANGE),
        ({"covariance": np.full((2, 2), math.nan)}, Reason.BAD_COVARIANCE),
        ({"covariance": np.diag((-1.0, 1.0))}, Reason.BAD_COVARIANCE),
        ({"covariance": [[1.0, 2.0], [2.0, 1.0]]}, Reason.BAD_COVARIANCE),
        ({"covariance": np.diag((500.0, 1.0))}, Reason.UNCERTAIN),
        ({"latitude": 33.889}, Reason.HEMISPHERE),
        ({"longitude": -151.193}, Reason.HEMISPHERE),
        ({"longitude": -28.807, "latitude": 33.889}, Reason.HEMISPHERE),  # the antipode
        ({"latitude": -35.0}, Reason.FAR),
    ],
)
def test_fix_is_refused_by_name(fields, reason):
    gnss = localizer(**DATUM)
    assert gnss.locate(fix(**fields)) is reason
    assert gnss.tally.by_source() == {"fix": {reason.value: 1}}
    assert isinstance(gnss.locate(fix()), AntennaPosition)


def test_equator_and_date_line_divide_nothing():
    for datum, there in (((0.0001, 30.0), (-0.0001, 30.0)), ((-17.0, 179.9999), (-17.0, -179.9999))):
        gnss = localizer(datum_latitude=datum[0], datum_longitude=datum[1], datum_altitude=60.0)
        position = gnss.locate(fix(*there))
        assert isinstance(position, AntennaPosition)
        assert math.hypot(position.east, position.north) < 30.0


@pytest.mark.parametrize("status", [0, 1, 2, 3])
@pytest.mark.parametrize("zeros", [False, True])
def test_unknown_covariance_is_assumed_by_status(status, zeros):
    kind, covariance = (2, np.zeros((2, 2))) if zeros else (0, np.full((2, 2), 7.0))
    up = 0.0 if zeros else 7.0
    position = localizer(**DATUM).locate(fix(status=status, covariance=covariance, kind=kind, up=up))
    assert isinstance(position, AntennaPosition)
    assert position.up_variance == pytest.approx(4.0 * position.covariance[0, 0])
    assert position.covariance[0, 0] == (3.0**2, 1.0**2, 0.3**2, 0.3**2)[status]


def test_datum_is_the_first_of_the_fixes_that_agree():
    gnss = localizer(datum_fixes=3)
    assert gnss.locate(fix(10.0, 10.0)) is Reason.NO_DATUM  # an outlier at the start
    assert gnss.locate(fix(-33.8890, 151.193)) is Reason.NO_DATUM
    assert gnss.locate(fix(status=-1)) is Reason.NO_FIX
    assert gnss.locate(fix(-33.8891, 151.193)) is Reason.NO_DATUM
    position = gnss.locate(fix(-33.8892, 151.193))
    assert gnss.datum == Datum(-33.8890, 151.193, 60.0)
    assert isinstance(position, AntennaPosition)
    assert (position.east, position.north) == pytest.approx((0.0, -22.18), abs=0.01)
    assert gnss.locate(fix(10.0, 10.0)) is Reason.HEMISPHERE


def test_datum_at_a_pole_is_refused():
    with pytest.raises(
        InputError, match=r"datum_latitude: 89\.5 is out of range; accepted: >= -89 and <= 89"
    ):
        localizer(datum_latitude=89.5)


numbers = st.floats(allow_nan=True, allow_infinity=True)


@given(
    numbers,
    numbers,
    numbers,
    st.integers(-128, 127),
    st.lists(numbers, min_size=4, max_size=4),
    st.integers(0, 255),
)
def test_any_fix_gives_a_position_or_a_rejection(latitude, longitude, altitude, status, covariance, kind):
    gnss = localizer(**DATUM)
    outcome = gnss.locate(fix(latitude, longitude, altitude, status, np.reshape(covariance, (2, 2)), kind))
    if isinstance(outcome, AntennaPosition):
        assert math.hypot(outcome.east, outcome.north) <= 1e5
        assert np.linalg.eigvalsh(outcome.covariance).min() >= -1e-9 * outcome.covariance.trace()
    else:
        assert gnss.tally.total.total() == 1
