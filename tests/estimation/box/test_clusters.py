# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Scans are segmented into objects."""

import numpy as np
import pytest

from trackslip_estimation.box.clusters import object_beams, rejoin_parts, segment_scan

SPACING = np.pi / 360.0
ANGLES = -np.pi / 2.0 + SPACING * np.arange(361)
GRAZING = 0.17


def scan(**objects):
    """An empty scan except for objects ``name=(first, last, range)``."""
    ranges = np.full(361, np.inf)
    for first, last, distance in objects.values():
        ranges[first : last + 1] = distance
    return ranges


def spans(parts):
    return [(int(part[0]), int(part[-1])) for part in parts]


def test_empty_scan_has_no_clusters():
    assert segment_scan(np.full(361, np.inf), ANGLES, 0.03, GRAZING) == []


def test_range_jump_and_missing_return_separate_objects():
    ranges = scan(box=(100, 109, 8.0), wall=(110, 120, 12.0), post=(125, 127, 8.0))
    assert spans(segment_scan(ranges, ANGLES, 0.03, GRAZING)) == [(100, 109), (110, 120), (125, 127)]


def test_single_beam_without_return_does_not_cut_an_object():
    ranges = scan(box=(100, 109, 8.0), post=(111, 113, 8.0))
    ranges[103] = np.inf
    assert spans(segment_scan(ranges, ANGLES, 0.03, GRAZING)) == [(100, 113)]


def test_invalid_beam_inside_an_object_does_not_cut_it():
    ranges = scan(box=(100, 109, 8.0))
    ranges[104] = np.nan
    (part,) = segment_scan(ranges, ANGLES, 0.03, GRAZING)
    assert part.tolist() == [100, 101, 102, 103, 105, 106, 107, 108, 109]


@pytest.mark.parametrize(("distance", "cut"), [(2.0, True), (12.0, False)])
def test_allowed_jump_grows_with_range(distance, cut):
    ranges = scan(near=(100, 105, distance), far=(106, 110, distance + 0.4))
    assert (len(segment_scan(ranges, ANGLES, 0.03, GRAZING)) == 2) is cut


@pytest.mark.parametrize(("between", "expected"), [(5.0, [(100, 109)]), (12.0, [])])
def test_object_is_rejoined_where_something_nearer_cuts_it(between, expected):
    ranges = scan(left=(100, 103, 8.0), other=(104, 105, between), right=(106, 109, 8.0))
    parts = segment_scan(ranges, ANGLES, 0.03, GRAZING)
    assert spans(rejoin_parts(parts, ranges, ANGLES, extent=1.0)) == expected


def test_free_ends_are_between_neighbouring_beams():
    ranges = scan(box=(100, 109, 8.0))
    beams = object_beams(np.arange(100, 110), ranges, ANGLES, extent=0.92, margin=0.1)
    assert beams.right == pytest.approx((ANGLES[99], ANGLES[100]))
    assert beams.left == pytest.approx((ANGLES[109], ANGLES[110]))


@pytest.mark.parametrize("other", [(106, 108, 5.0), (106, 107, 8.7)], ids=["nearer", "just behind"])
def test_end_beside_an_occluding_object_is_bounded_by_that_object(other):
    ranges = scan(box=(100, 105, 8.0), other=other)
    beams = object_beams(np.arange(100, 106), ranges, ANGLES, extent=0.92, margin=0.1)
    assert beams.left == pytest.approx((ANGLES[105], ANGLES[other[1] + 1]))


def test_end_at_the_edge_of_view_is_bounded_by_the_extent():
    ranges = scan(box=(355, 360, 8.0))
    beams = object_beams(np.arange(355, 361), ranges, ANGLES, extent=0.92, margin=0.1)
    widest = 2.0 * np.arcsin(0.46 / 8.0)
    assert beams.left == pytest.approx((ANGLES[360], ANGLES[355] + widest))
