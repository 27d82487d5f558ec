# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Positions off the map, without a standard deviation or too coarse for it, in CSV logs and bags."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.imports import import_csv, import_messages, import_topics
from fixtures.made_bags import fix, write_bag

from trackslip_bags.importing.importer import Imported
from trackslip_common.config_files import node_defaults
from trackslip_common.errors import InputError
from trackslip_common.make import stamp_ns_of
from trackslip_estimation.gnss.localizer import Reason
from trackslip_estimation.gnss.parameters import NODE

SITE = (-33.889, 151.193)
NEAR = [(SITE[0] + 1e-5 * k, SITE[1]) for k in range(8)]  # 1.1 m apart
WRONG_SIGN = {"latitude": 33.889, "longitude": 151.193}
AT_SITE = {"latitude": SITE[0], "longitude": SITE[1], "altitude": 60.0}
CSV = {k: {"column": k[:3], "unit": "deg"} for k in ("latitude", "longitude")}
STDDEV = {"stddev": {"x": 0.02, "y": 0.02}}


def import_fixes(folder: Path, fixes: list[Any], **more: Any) -> tuple[Imported, list[Any]]:
    sent = (("/fix", one) for one in fixes)
    return import_messages(folder, sent, {"gnss_pose": {"from": "/fix"}}, **more)


@pytest.fixture(params=["csv", "bag"])
def import_places(request: pytest.FixtureRequest, tmp_path: Path) -> Any:
    """A function that imports a log of positions, CSV or bag."""

    def run(places: list[tuple[float, float]], **more: Any) -> tuple[Imported, list[Any]]:
        if request.param == "csv":
            rows = [f"{k},{latitude},{longitude}" for k, (latitude, longitude) in enumerate(places)]
            text = "\n".join(("t,lat,lon", *rows, ""))
            return import_csv(tmp_path, text, {"gnss_pose": {**CSV, **STDDEV}}, **more)
        fixes = [fix(0.2 * k, *at) for k, at in enumerate(places)]
        return import_fixes(tmp_path, fixes, **more)

    return run


def test_datum_in_another_hemisphere_is_refused(import_places: Any, tmp_path: Path) -> None:
    """One sign of the datum is wrong: the import fails and states both positions."""
    with pytest.raises(InputError) as caught:
        import_places(NEAR, datum=WRONG_SIGN)
    text = str(caught.value)
    assert "the first, at latitude -33.889000, longitude 151.193000 deg, is " in text
    assert f"{Reason.HEMISPHERE.value} (33.889000, 151.193000)" in text
    assert "accepted: within 100 km of it" in text
    assert "\n" not in text
    assert not (tmp_path / "out").exists()


def test_a_log_too_far_from_the_datum_is_refused(import_places: Any) -> None:
    with pytest.raises(InputError, match=r"is too far from the datum \(-35\.5"):
        import_places(NEAR, datum={"latitude": -35.5, "longitude": 151.193})


def test_wild_positions_are_left_out_and_counted(import_places: Any) -> None:
    """gnss_localizer has the same limit of distance."""
    wild = [(33.889, 151.193), (-35.0, 151.193)]
    result, messages = import_places([*NEAR[:3], *wild, *NEAR[3:]], datum=AT_SITE)
    assert result.left_out["/gnss_pose"] == {Reason.HEMISPHERE.value: 1, Reason.FAR.value: 1}
    assert len(messages) == len(NEAR)
    assert all(abs(m.pose.pose.position.y) < 10.0 for m in messages)
    assert node_defaults(NODE, f"{NODE}.yaml")["max_distance"] == 1e5


def test_outlying_first_position_is_no_datum(import_places: Any) -> None:
    result, messages = import_places([(33.889, 151.193), (10.0, 20.0), *NEAR])
    assert result.datum is not None
    assert result.datum[:2] == pytest.approx(NEAR[0])
    assert sum(result.left_out["/gnss_pose"].values()) == 2
    assert len(messages) == len(NEAR)


def test_positions_that_have_nothing_in_common_give_no_datum(import_places: Any) -> None:
    with pytest.raises(InputError, match="no position has half of the 6 within 100 km; accepted: datum"):
        import_places([(10.0 * k, 20.0) for k in range(1, 7)])


def test_a_datum_at_a_pole_is_refused(import_places: Any) -> None:
    with pytest.raises(InputError, match=r"datum: 89\.5, 0 is out of range; accepted: latitude in -89 … 89"):
        import_places(NEAR, datum={"latitude": 89.5, "longitude": 0.0})


def test_a_latitude_that_is_none_is_left_out_of_a_bag(tmp_path: Path) -> None:
    places = [NEAR[0], (-91.0, 151.0), *NEAR[1:]]
    result, messages = import_fixes(tmp_path, [fix(0.2 * k, *at) for k, at in enumerate(places)])
    assert result.left_out["/gnss_pose"] == {Reason.OUT_OF_RANGE.value: 1}
    assert len(messages) == len(NEAR)


def test_fix_without_covariance_does_not_refuse_the_bag(tmp_path: Path) -> None:
    """Such a fix is left out and counted, like such a row of a CSV log."""
    fixes = [fix(0.2 * k, *at, kind=0 if k == 3 else 2) for k, at in enumerate(NEAR)]
    fixes[5].position_covariance[4] = math.nan
    result, messages = import_fixes(tmp_path, fixes)
    assert result.left_out["/gnss_pose"] == {"no variance of x above 0": 1, "no variance of y above 0": 1}
    assert len(messages) == len(NEAR) - 2
    assert messages[0].pose.covariance[0] == pytest.approx(4e-4)


def test_bag_of_fixes_without_covariance_needs_a_stddev(tmp_path: Path) -> None:
    log = write_bag(tmp_path / "log", (("/fix", fix(0.2 * k, *at, kind=0)) for k, at in enumerate(NEAR)))
    with pytest.raises(InputError, match=r"/fix states no variance of x that is above 0; accepted: stddev"):
        import_topics(tmp_path, log, {"gnss_pose": {"from": "/fix"}})
    _, messages = import_topics(tmp_path, log, {"gnss_pose": {"from": "/fix", **STDDEV}})
    assert len(messages) == len(NEAR)


def at(k: int) -> tuple[float, float]:
    """Latitude and longitude, deg, on a drive to the north east."""
    return SITE[0] + 2e-6 * k, SITE[1] + 2.7e-6 * k + 3e-6 * math.sin(k)


def of_digits(digits: int) -> list[str]:
    """Rows of the drive with ``digits`` digits behind the decimal point."""
    return [f"{k},{at(k)[0]:.{digits}f},{at(k)[1]:.{digits}f}" for k in range(60)]


def of_32_bits() -> list[str]:
    return [f"{k},{np.float32(at(k)[0])!s},{np.float32(at(k)[1])!s}" for k in range(60)]


@pytest.mark.parametrize("rows", [of_digits(5), of_32_bits()], ids=["five digits", "32 bit floats"])
def test_positions_coarser_than_their_stddev_are_refused(rows: list[str], tmp_path: Path) -> None:
    """Rounded positions repeat and step; with a small stddev they are wrong by 25 m or 1.4 m."""
    text = "\n".join(("t,lat,lon", *rows, ""))
    with pytest.raises(InputError, match=r"log\.csv: column 'l\w\w' is rounded by [\d.]+ m, and stddev of"):
        import_csv(tmp_path, text, {"gnss_pose": {**CSV, **STDDEV}})
    as_coarse = {"stddev": {"x": 1.0, "y": 1.0}}
    _, messages = import_csv(tmp_path, text, {"gnss_pose": {**CSV, **as_coarse}})
    assert len(messages) == len(rows)


@pytest.mark.parametrize("rows", [of_digits(8), [f"{k},{SITE[0]},{SITE[1] + 1e-5 * k}" for k in range(60)]])
def test_positions_of_enough_digits_are_accepted(rows: list[str], tmp_path: Path) -> None:
    """At a constant speed all differences of the positions are equal."""
    text = "\n".join(("t,lat,lon", *rows, ""))
    _, messages = import_csv(tmp_path, text, {"gnss_pose": {**CSV, **STDDEV}})
    assert len(messages) == len(rows)


def test_a_place_of_no_latitude_is_refused_with_a_missing_value(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"9999 deg is no latitude; .*missing: 9999, or another unit"):
        import_csv(tmp_path, "t,lat,lon\n0,9999,9999\n", {"gnss_pose": {**CSV, **STDDEV}})


def held_rows(places: list[tuple[float, float]], times: int) -> list[str]:
    """Rows of a table in which each place comes several times, as beside a faster sensor."""
    rows = [place for place in places for _ in range(times)]
    return [f"{0.1 * k:.1f},{latitude},{longitude}" for k, (latitude, longitude) in enumerate(rows)]


@pytest.mark.parametrize("digits", [9, 5])
def test_a_position_that_the_log_holds_is_one_message(digits: int, tmp_path: Path) -> None:
    """Each new position has the time of its first row; the age of the first one is unknown."""
    places = [(round(at(k)[0], digits), round(at(k)[1], digits)) for k in range(60)]
    text = "\n".join(("t,lat,lon", *held_rows(places, 10), ""))
    coarse = {"gnss_pose": {**CSV, "stddev": {"x": 1.0, "y": 1.0}}}
    result, messages = import_csv(tmp_path, text, coarse)
    changes = [k for k in range(1, 60) if places[k] != places[k - 1]]
    assert [stamp_ns_of(m) // 10**9 for m in messages] == changes
    assert any("gnss_pose: the log holds each pose for about" in note for note in result.notes)


def test_a_position_that_stays_at_standstill_is_not_held(tmp_path: Path) -> None:
    places = [at(0)] * 200 + [at(k) for k in range(60)]
    _, messages = import_csv(
        tmp_path, "\n".join(("t,lat,lon", *held_rows(places, 1), "")), {"gnss_pose": {**CSV, **STDDEV}}
    )
    assert len(messages) == len(places)


def test_degrees_and_minutes_are_degrees(tmp_path: Path) -> None:
    """As a receiver writes them: 33° 53.34′ south, 151° 11.58′ east."""
    minutes = {
        "latitude": {"column": "lat", "unit": "ddmm.mmmm", "scale": -1},
        "longitude": {"column": "lon", "unit": "ddmm.mmmm"},
    }
    text = "t,lat,lon\n0,3353.34,15111.58\n1,3353.3406,15111.58\n"
    result, (first, second) = import_csv(tmp_path, text, {"gnss_pose": {**minutes, **STDDEV}})
    assert result.datum is not None
    assert result.datum[:2] == pytest.approx(SITE)
    assert second.pose.pose.position.y - first.pose.pose.position.y == pytest.approx(-1.109, abs=0.001)


def test_degrees_and_minutes_that_are_declared_degrees_are_refused_with_their_unit(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"3353\.34 deg is no latitude; .*unit: ddmm\.mmmm in the mapping"):
        import_csv(tmp_path, "t,lat,lon\n0,3353.34,15111.58\n", {"gnss_pose": {**CSV, **STDDEV}})
