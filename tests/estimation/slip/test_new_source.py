# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A source of a new kind needs one function, its observation. Here: ranges."""

import math

import numpy as np
from fixtures.filter_steps import STANDSTILL, Gaussian, config_of, start_of, state_of

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import root, weighted_square
from trackslip_estimation.kalman.update import (
    Observation,
    correct,
    independent_observation,
    inflate_noise_to_gate,
    predicted_covariance,
)
from trackslip_estimation.slip.config import Config
from trackslip_estimation.slip.levers import lever
from trackslip_estimation.slip.models.model import X, Y
from trackslip_estimation.slip.records import MEASUREMENT, MeasurementRecord, State

BEACONS = ((0.0, 10.0), (12.0, 0.0), (-9.0, -7.0))  # m
ARM = {"sources.box_pose.lever_arm_x": 0.6, "sources.box_pose.lever_arm_y": 0.2}
SIGMA = 0.05  # m


@compiled
def observe_range(state: State, measurement: MeasurementRecord, c: Config) -> Observation:
    """The range to a beacon at ``value[1:]``: h = |C + R(φ) l − beacon|."""
    x = state.mean[: c.size]
    arm, H = lever(x, state.attitude.level, measurement.source, c), np.zeros((1, x.size))
    east = x[X] + arm.east - measurement.value[1]
    north = x[Y] + arm.north - measurement.value[2]
    distance = math.hypot(east, north)
    H[0] = (east * arm.jacobian[X] + north * arm.jacobian[Y]) / distance
    H[0, X], H[0, Y] = east / distance, north / distance
    return independent_observation(
        np.array((measurement.value[0] - distance,)), H, measurement.noise[:1, :1].copy()
    )


def test_ranges_to_beacons_locate_a_machine() -> None:
    config, rng, truth = config_of(ARM), np.random.default_rng(3), np.array((2.0, -1.0, 0.4))
    known = start_of(config, np.array((0.5, 0.5, 0.3)), np.diag((4.0, 4.0, 0.05)))
    state, c = state_of(Gaussian(*known), STANDSTILL)[0], config[0]
    cos, sin = math.cos(truth[2]), math.sin(truth[2])
    antenna = truth[:2] + np.array((cos * 0.6 - sin * 0.2, sin * 0.6 + cos * 0.2))
    for k in range(60):
        measurement, beacon = np.zeros(1, MEASUREMENT)[0], np.array(BEACONS[k % 3])
        distance = np.linalg.norm(antenna - beacon) + SIGMA * rng.normal()
        measurement["value"], measurement["noise"][0, 0] = (distance, *beacon), SIGMA**2
        o = observe_range(state, measurement, c)
        inflate_noise_to_gate(
            o.noise, o.innovation, predicted_covariance(state["covariance"], o.jacobian), 9.0
        )
        correct(state["mean"], state["covariance"], o)
    error, P = state["mean"][:3] - truth, state["covariance"][:3, :3].copy()
    assert np.hypot(*error[:2]) < 0.3  # a heading error of 0.1 rad rotates C about the antenna
    assert weighted_square(root(P), error) < 16.3  # χ² of three, 0.1 %
    assert P[X, X] < 0.1
