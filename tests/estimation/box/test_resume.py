# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A localizer that is killed during a drive continues from its file after a restart."""

import dataclasses
import json

import numpy as np
import pytest
from fixtures.box_site import BOX, CEILING, PARAMETERS, PERIOD, SITE, assert_near, drive, standing, turning
from hypothesis import given
from hypothesis import strategies as st

from trackslip_common.errors import InputError
from trackslip_estimation.box.localizer import BoxFix, BoxLocalizer
from trackslip_estimation.box.track_file import TrackFile, parse_track, track_text
from trackslip_sim.machine.scan_model import SiteScanner

SCANS = 60  # of a turn, to 1.9 rad from the initial heading
AWAY = 10  # scans without a localizer
NEAR = dataclasses.replace(PARAMETERS, initial_reach=1.0)


@pytest.fixture(scope="module")
def state():
    """The saved state of a localizer after a turn."""
    localizer = BoxLocalizer(NEAR, BOX)
    drive(localizer, SiteScanner(SITE, BOX, seed=1), turning, SCANS)
    return localizer.saved_state


def fixes_of(localizer, first):
    outcomes = drive(localizer, SiteScanner(SITE, BOX, seed=2), turning, 20, first=first)
    return [fix for fix in outcomes if isinstance(fix, BoxFix)]


def test_a_localizer_killed_far_from_its_start_finds_the_box_again(state, tmp_path):
    TrackFile(str(tmp_path / "track.json")).write(state)
    after = BoxLocalizer(NEAR, BOX, TrackFile(str(tmp_path / "track.json")).read())
    fixes = fixes_of(after, SCANS + AWAY)
    assert after.resumed
    assert len(fixes) >= 18
    assert_near(fixes[-1], turning)
    wrong = [
        f
        for f in fixes
        if abs(f.yaw - turning(f.stamp_ns * 1e-9)[2]) > 0.5 and f.covariance[2, 2] < CEILING**2
    ]
    assert wrong == []
    assert fixes_of(BoxLocalizer(NEAR, BOX), SCANS + AWAY) == []


def test_a_localizer_killed_while_the_box_is_out_of_sight_finds_it_again(state):
    """The box is hidden for longer than a track is kept, but a running localizer would find it too."""
    before, scanner = BoxLocalizer(NEAR, BOX, state), SiteScanner(SITE, BOX, seed=1)
    unseen = round(NEAR.resume_time / PERIOD) + 10
    out_of_sight = drive(before, scanner, standing(0.0, -60.0, 0.0), unseen, first=SCANS)
    assert not any(isinstance(fix, BoxFix) for fix in out_of_sight)
    after = BoxLocalizer(NEAR, BOX, before.saved_state)
    fixes = fixes_of(after, SCANS + unseen + AWAY)
    assert after.resumed
    assert len(fixes) >= 18
    assert_near(fixes[-1], turning)


def test_a_track_of_long_ago_or_of_the_future_is_not_used(state):
    pose_at = standing(0.0, 0.0, 0.0)
    late = round(NEAR.resume_time / 0.21) + SCANS + 10
    for first in (0, late):
        fresh, resumed = BoxLocalizer(NEAR, BOX), BoxLocalizer(NEAR, BOX, state)
        there = drive(resumed, SiteScanner(SITE, BOX, seed=2), pose_at, 5, first=first)
        assert not resumed.resumed
        assert [fix.yaw for fix in there] == [
            fix.yaw for fix in drive(fresh, SiteScanner(SITE, BOX, seed=2), pose_at, 5, first=first)
        ]


def test_track_file_restores_track_and_background(state):
    parsed = parse_track(track_text(state))
    assert parsed.scan_ns == state.scan_ns
    track, again = state.track, parsed.track
    assert again.stamp_ns == track.stamp_ns
    np.testing.assert_array_equal(again.mean, track.mean)
    np.testing.assert_array_equal(again.covariance, track.covariance)
    np.testing.assert_array_equal(again.headings.weights, track.headings.weights)
    assert again.headings.evidence == track.headings.evidence
    assert parsed.laser == (NEAR.laser_x, NEAR.laser_y, NEAR.laser_yaw)
    for name in ("ranges", "free"):
        expected = getattr(state.background, name)
        assert np.isfinite(expected).any()
        np.testing.assert_allclose(getattr(parsed.background, name), expected, atol=5.1e-4)


def test_file_of_an_older_version_is_refused_in_one_line(state, tmp_path):
    path = tmp_path / "track.json"
    path.write_text(json.dumps({**json.loads(track_text(state)), "version": 2}), encoding="utf-8")
    file = TrackFile(str(path))
    assert file.read() is None
    assert file.failure == f"{path} is not used: it is of version '2', not 3"


@given(
    st.text(max_size=200)
    | st.recursive(st.none() | st.floats() | st.text(), st.lists, max_leaves=5).map(json.dumps)
)
def test_any_other_text_is_refused(text):
    with pytest.raises(InputError):
        parse_track(text)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("stamp_ns", 2**63),
        ("scan_ns", -1),
        ("scan_ns", 2**63),
        ("stamp_ns", -1),
        ("mean", [[0.0, float("nan")]] * 3),
        ("mean", [0.0]),
        ("covariance", [[[-1.0, 0.0], [0.0, 1.0]]] * 3),
        ("covariance", [[[1.0, 0.5], [0.0, 1.0]]] * 3),
        ("weights", [0.5, 0.5, 0.5, 0.5]),
        ("evidence", [0.0, 0.0, -1, 0.0, 0.0]),
        ("evidence", [0.0, 0.0, float("inf"), 0.0, 0.0]),
        ("laser", [0.0, 0.0, float("nan")]),
        ("beams", [0.0, 1e9]),
        ("background", "12"),
        ("background", [-2] * 361),
        ("free", [1.0]),
    ],
)
def test_a_changed_value_is_refused(state, tmp_path, key, value):
    tree = json.loads(track_text(state))
    path = tmp_path / "track.json"
    path.write_text(json.dumps({**tree, key: value}), encoding="utf-8")
    file = TrackFile(str(path))
    assert file.read() is None
    assert str(path) in file.failure


def test_file_that_is_no_track_is_kept_under_another_name(state, tmp_path):
    """``track_file`` names a text file of the user."""
    path = tmp_path / "notes.txt"
    for text in ("years of work", "more of it"):
        path.write_text(text, encoding="utf-8")
        file = TrackFile(str(path))
        assert file.read() is None
        file.write(state)
    assert path.with_name("notes.txt.unused").read_text(encoding="utf-8") == "years of work"
    assert path.with_name("notes.txt.unused-2").read_text(encoding="utf-8") == "more of it"
    assert TrackFile(str(path)).read() is not None
    assert len(list(tmp_path.iterdir())) == 3


def test_a_place_that_cannot_be_written_is_reported_and_ends_nothing(state, tmp_path):
    (tmp_path / "file").write_text("", encoding="utf-8")
    file = TrackFile(str(tmp_path / "file" / "track.json"))
    file.write(state)
    assert file.failures == 1
    assert "is not written" in file.failure
    assert TrackFile("").read() is None
