# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The rectangle's measurement model and its fit."""

import subprocess
import sys

import numpy as np
import pytest

from trackslip_estimation.box.clusters import object_beams
from trackslip_estimation.box.fit import count_beams_through, fit_pose, likely_starting_poses, posterior
from trackslip_estimation.box.measurement_model import (
    Rectangle,
    costs,
    fit_input,
    pairwise_sum,
    predict_scan,
    total_cost,
)

BOX = Rectangle(0.7, 0.6)
ANGLES = -np.pi / 2.0 + np.pi / 360.0 * np.arange(361)
HEADINGS = np.linspace(-0.7, 0.7, 13)


def box_ranges(pose):
    """Noise-free ranges (361,) of a box alone."""
    ranges, outline = predict_scan(pose[np.newaxis], BOX, ANGLES)
    return np.where((outline[0, 0] <= ANGLES) & (outline[0, 1] >= ANGLES), ranges[0], np.inf)


def beams_of(ranges, indices=None):
    indices = np.flatnonzero(np.isfinite(ranges)) if indices is None else indices
    return object_beams(indices, ranges, ANGLES, BOX.diagonal, 0.05)


def fitted(ranges, heading, stddev, indices=None):
    beams = beams_of(ranges, indices)
    start = likely_starting_poses(heading + HEADINGS, BOX, beams, stddev)[0]
    return posterior(fit_pose(start, BOX, beams, stddev), heading, BOX, beams, stddev)[:2]


def test_ray_cast_face_on():
    ranges, outline = predict_scan(np.array([[5.0, 0.0, 0.0]]), BOX, np.array([0.0, 0.03, 0.5]))
    corner = np.arctan2(0.3, 4.65)
    assert ranges[0] == pytest.approx([4.65, 4.65 / np.cos(0.03), 4.65 / np.cos(corner)])
    assert outline[0] == pytest.approx([-corner, corner])


def test_rays_end_on_the_outline_of_the_rectangle():
    random = np.random.default_rng(2)
    for _ in range(50):
        x, y, heading = random.uniform([2.0, -5.0, -3.1], [9.0, 5.0, 3.1])
        (ranges,), ((right, left),) = predict_scan(np.array([[x, y, heading]]), BOX, ANGLES)
        hit = (right < ANGLES) & (left > ANGLES)
        dx, dy = ranges * np.cos(ANGLES) - x, ranges * np.sin(ANGLES) - y
        along = np.abs(np.cos(heading) * dx + np.sin(heading) * dy)[hit] / 0.35
        across = np.abs(-np.sin(heading) * dx + np.cos(heading) * dy)[hit] / 0.3
        assert np.maximum(along, across) == pytest.approx(1.0)
        assert np.all(np.hypot(dx, dy)[hit] <= BOX.diagonal / 2.0 + 1e-9)


def test_residuals_vanish_at_the_truth_but_for_the_ends():
    pose = np.array([6.0, 1.0, 0.4])
    (values,) = costs(pose[np.newaxis], fit_input(BOX, beams_of(box_ranges(pose)), 0.01))
    assert values[:-2] == pytest.approx(0.0, abs=1e-18)
    assert np.all(values[-2:] <= 3.0)


def test_a_cost_is_the_sum_that_numpy_makes_of_its_parts():
    pose = np.array([[1.2, 0.1, 0.4]])
    beams = beams_of(box_ranges(pose[0]))
    inputs = fit_input(BOX, beams, 0.01)
    assert total_cost(pose[0], inputs) == costs(pose, inputs).sum()
    values = np.random.default_rng(1).lognormal(size=700)
    assert all(pairwise_sum(values[:count]) == values[:count].sum() for count in range(len(values)))


def test_heading_turns_with_the_start():
    ranges = box_ranges(np.array([4.0, 0.0, 0.5]))
    estimate, _ = fitted(ranges, 0.5 + np.pi, 0.01)
    assert estimate[2] == pytest.approx(0.5 + np.pi, abs=0.05)


def test_one_edge_with_hidden_ends_is_uncertain_along_the_edge_only():
    ranges = box_ranges(np.array([5.0, 0.0, 0.0]))
    side = np.flatnonzero(np.isfinite(ranges))
    ranges[side[0] - 6 : side[4]] = 3.0
    ranges[side[-4] : side[-1] + 7] = 3.0
    _, covariance = fitted(ranges, 0.0, 0.01, side[4:-4])
    across, along = np.sqrt(np.diag(covariance))[:2]
    assert along > 0.06
    assert across < 0.03


def test_one_edge_with_free_ends_is_as_certain_as_the_spacing_allows():
    _, covariance = fitted(box_ranges(np.array([5.0, 0.0, 0.0])), 0.0, 0.01)
    spacing = 5.0 * np.pi / 360.0
    assert 0.1 * spacing < np.sqrt(covariance[1, 1]) < 0.5 * spacing


def test_beams_that_go_on_behind_are_counted():
    pose = np.array([5.0, 0.0, 0.0])
    ranges = box_ranges(pose)
    assert count_beams_through(pose, BOX, ranges, ANGLES, 0.1) == 0
    ranges[178:182] = 9.0
    assert count_beams_through(pose, BOX, ranges, ANGLES, 0.1) == 4


def test_covariance_is_symmetric_and_positive_definite_and_repeatable():
    random = np.random.default_rng(3)
    for _ in range(20):
        pose = random.uniform([2.0, -4.0, -3.1], [10.0, 4.0, 3.1])
        ranges = box_ranges(pose) + 0.02 * random.standard_normal(361)
        first, covariance = fitted(ranges, pose[2], 0.02)
        again, _ = fitted(ranges, pose[2], 0.02)
        assert np.array_equal(first, again)
        assert covariance == pytest.approx(covariance.T)
        assert np.all(np.linalg.eigvalsh(covariance) > 0.0)


COMPILED_BEFORE = """
import numpy as np
from numba.core.dispatcher import Dispatcher
from trackslip_estimation.box import fit, measurement_model
from trackslip_estimation.box.clusters import object_beams

def signatures():
    functions = {**vars(fit), **vars(measurement_model)}
    return {name: list(f.signatures) for name, f in functions.items() if isinstance(f, Dispatcher)}

fit.compile_fit()
before = signatures()
assert all(before[name] for name in ("_descend", "range_costs")), before
box, angles = fit.Rectangle(0.7, 0.6), np.linspace(-1.57, 1.57, 361)
ranges, outline = fit.predict_scan(np.array([[4.0, 1.0, 0.5]]), box, angles)
on = np.flatnonzero((outline[0, 0] <= angles) & (angles <= outline[0, 1]))
beams = object_beams(on, ranges[0], angles, box.diagonal, 0.05)
start = fit.likely_starting_poses(np.linspace(0.0, 1.0, 13), box, beams, 0.01)[0]
fit.posterior(fit.fit_pose(start, box, beams, 0.01), 0.5, box, beams, 0.01)
assert signatures() == before
"""


def test_first_scan_needs_no_compilation():
    subprocess.run([sys.executable, "-c", COMPILED_BEFORE], check=True)
