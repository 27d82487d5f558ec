# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Positions off the map, without a standard deviation or too coarse for it, in CSV logs and bags."""

import math
from collections.abc import Callable
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
from trackslip_estimation.slip.measurements import UNOBSERVED

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


@pytest.mark.parametrize(
    ("datum", "text"),
    [
        (WRONG_SIGN, f"{Reason.HEMISPHERE.value} (33.889000, 151.193000); accepted: within 100 km of it"),
        ({"latitude": -35.5, "longitude": 151.193}, "is too far from the datum (-35.5"),
        ({"latitude": 89.5, "longitude": 0.0}, "89.5, 0 is out of range; accepted: latitude in -89 … 89"),
    ],
)
def test_datum_far_from_the_log_is_refused(
    import_places: Any, tmp_path: Path, datum: dict[str, float], text: str
) -> None:
    """One sign of the datum is wrong: the import fails and states both positions."""
    with pytest.raises(InputError) as caught:
        import_places(NEAR, datum=datum)
    assert text in str(caught.value)
    if datum["latitude"] < 89.0:
        assert "the first, at latitude -33.889000, longitude 151.193000 deg, is " in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


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


def test_fixes_of_a_bag_without_place_or_covariance_are_left_out(tmp_path: Path) -> None:
    fixes = [fix(0.2 * k, *at, kind=0 if k == 3 else 2) for k, at in enumerate(NEAR)]
    fixes[5].position_covariance[4] = math.nan
    fixes[6].latitude = -91.0
    result, messages = import_fixes(tmp_path, fixes)
    left_out = {"no variance of x above 0": 1, "no variance of y above 0": 1, Reason.OUT_OF_RANGE.value: 1}
    assert result.left_out["/gnss_pose"] == left_out
    assert len(messages) == len(NEAR) - 3
    assert messages[0].pose.covariance[0] == pytest.approx(4e-4)


def test_bag_of_fixes_without_covariance_needs_a_stddev(tmp_path: Path) -> None:
    """That of the mapping is the covariance of fixes, and of poses, in any order of its entries."""
    log = write_bag(tmp_path / "log", (("/fix", fix(0.2 * k, *at, kind=0)) for k, at in enumerate(NEAR)))
    with pytest.raises(InputError, match=r"/fix states no variance of x that is above 0; accepted: stddev"):
        import_topics(tmp_path, log, {"gnss_pose": {"from": "/fix"}})
    stated = {"from": "/fix", "covariance": {"xy": -1e-4, "x": 4e-4, "y": 9e-4}}
    _, messages = import_topics(tmp_path, log, {"fix": stated, "gnss_pose": stated})
    fixes, poses = messages[: len(NEAR)], messages[len(NEAR) :]
    assert len(poses) == len(NEAR)
    expected = [[4e-4, -1e-4], [-1e-4, 9e-4]]
    np.testing.assert_allclose(poses[0].pose.covariance.reshape(6, 6)[:2, :2], expected)
    np.testing.assert_allclose(fixes[0].position_covariance.reshape(3, 3)[:2, :2], expected)
    assert (fixes[0].position_covariance_type, fixes[0].position_covariance[8]) == (3, UNOBSERVED)


def at(k: int) -> tuple[float, float]:
    """Latitude and longitude, deg, on a drive to the north east."""
    return SITE[0] + 2e-6 * k, SITE[1] + 2.7e-6 * k + 3e-6 * math.sin(k)


@pytest.mark.parametrize(
    ("form", "is_coarse"),
    [(lambda x: f"{x:.5f}", True), (lambda x: str(np.float32(x)), True), (lambda x: f"{x:.8f}", False)],
    ids=["five digits", "32 bit floats", "eight digits"],
)
def test_positions_coarser_than_their_stddev_are_refused(
    form: Callable[[float], str], is_coarse: bool, tmp_path: Path
) -> None:
    """Rounded positions repeat and step; with a small stddev they are wrong by 25 m or 1.4 m."""
    rows = [",".join((str(k), *map(form, at(k)))) for k in range(60)]
    text = "\n".join(("t,lat,lon", *rows, ""))
    topics = {"gnss_pose": {**CSV, **STDDEV}}
    if is_coarse:
        with pytest.raises(InputError, match=r"column 'l\w\w' is rounded by [\d.]+ m, and stddev of"):
            import_csv(tmp_path, text, topics)
        topics["gnss_pose"]["stddev"] = {"x": 1.0, "y": 1.0}
    assert len(import_csv(tmp_path, text, topics)[1]) == len(rows)


@pytest.mark.parametrize(
    ("latitude", "is_refused"), [(math.radians(48.1), True), (0.001, False), (4.9, False)]
)
def test_radians_declared_as_degrees_are_refused(
    latitude: float, *, is_refused: bool, tmp_path: Path
) -> None:
    """No land is within π/2 and π degrees of 0, 0, where simulations are; no radians of land are near."""
    rows = [f"{k},{latitude + 1e-7 * k},-0.002" for k in range(4)]
    text = "\n".join(("t,lat,lon", *rows, *(f"{k},," for k in range(4, 9)), ""))
    topics = {"gnss_pose": {**CSV, **STDDEV}}
    if is_refused:
        with pytest.raises(InputError, match=r"sea off Africa; accepted: unit: rad"):
            import_csv(tmp_path, text, topics)
    else:
        assert len(import_csv(tmp_path, text, topics)[1]) == 4


def test_shortened_digits_of_floats_are_refused(tmp_path: Path) -> None:
    """Latitudes of 32 bit floats are 0.42 m apart here; their six digits after the point make that uneven."""
    rows = [f"{k},{np.float32(48.1 + 2e-4 * math.sin(k / 100))!s},11.6" for k in range(900)]
    with pytest.raises(InputError, match=r"column 'lat' is rounded by 0\.12 m"):
        import_csv(tmp_path, "\n".join(("t,lat,lon", *rows, "")), {"gnss_pose": {**CSV, **STDDEV}})


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


@pytest.mark.parametrize(
    ("latitude", "remedy"), [(9999, "missing: 9999, or another"), (3353.34, "ddmm.mmmm")]
)
def test_a_place_of_no_latitude_is_refused_with_the_remedy(
    latitude: float, remedy: str, tmp_path: Path
) -> None:
    text = f"t,lat,lon\n0,{latitude},15111.58\n"
    with pytest.raises(InputError, match=rf"line 2, column 'lat': {latitude} deg is no latitude; .*{remedy}"):
        import_csv(tmp_path, text, {"gnss_pose": {**CSV, **STDDEV}})
