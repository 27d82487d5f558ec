# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The table of measurement kinds: how each is observed, gated and used; compiled.

    state         record of ``STATE``, as predicted for the measurement's stamp; in place
    measurement   record of ``MEASUREMENT``, neither of sprockets nor manual
    c             record of ``config.CONFIG``
    update        record of ``UPDATE``: result of the step
    prior         record of ``PRIOR``: mean and covariance before the update

``observations`` has innovation, Jacobian, noise and consider states of each kind. The bank weighs poses,
headings, swing angles and velocities (``weighing``); the other kinds pass a gate that widens (``gate``). A
rejected measurement leaves mean and covariance unchanged, and lowers the evidence of the branch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled, inlined
from trackslip_estimation.kalman.update import Observation
from trackslip_estimation.slip.gate import log_probability_of_rejection, update_rejection_time
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.model import YAW
from trackslip_estimation.slip.observations.gyro import bias_index, observe_rate, update_with_rate
from trackslip_estimation.slip.observations.odometry import update_with_odometry
from trackslip_estimation.slip.observations.slips import observe_slips, update_with_slips
from trackslip_estimation.slip.records import GYROS, ODOMETRY, POSE, SLIPS, YAW_RATE
from trackslip_estimation.slip.source_faults import IS_HEALTHY, has_repeated_heading, log_density_of_repeat
from trackslip_estimation.slip.tilt import update_attitude
from trackslip_estimation.slip.weighing import observe_weighed, weigh_and_update
from trackslip_estimation.slip.window import is_weighed

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord, Prior, State, Update

_GATED = int(Outcome.GATED)


@inlined
def apply_measurement(
    state: State, measurement: MeasurementRecord, c: Config, update: Update, prior: Prior
) -> None:
    """Update the state by a measurement."""
    kind = measurement.kind
    if is_weighed(measurement):
        weigh_and_update(state, measurement, c, update, prior)
        if kind == POSE and has_repeated_heading(state, measurement.source):
            variance = 2.0 * max(measurement.noise[YAW, YAW], c.heading_floor[measurement.source] ** 2)
            update.evidence += log_density_of_repeat(update.squared_repeat_angle, variance, 1, c)
        return
    elapsed = (measurement.stamp_ns - state.received_ns[measurement.source]) * 1e-9
    update_rejection_time(state, measurement, c)
    if kind == YAW_RATE:
        if measurement.source == c.tilt_source:
            update.attitude = update_attitude(state, measurement, bias_index(measurement.source, c), c)
        if state.fault[GYROS] != IS_HEALTHY:  # it contradicts nothing
            state.consistent_ns[measurement.source], update.outcome = measurement.stamp_ns, _GATED
            return
        update_with_rate(state, measurement, c, update, prior)
    elif kind == ODOMETRY:
        update_with_odometry(state, measurement, c, update, prior)
    else:
        update_with_slips(state, measurement, c, update, prior)
    if update.outcome == _GATED and state.fault[measurement.source] == IS_HEALTHY:
        update.evidence = log_probability_of_rejection(elapsed, c)


@compiled
def observe(state: State, measurement: MeasurementRecord, c: Config) -> Observation:
    """Observation of a measurement that depends on one state: of any kind but odometry."""
    if measurement.kind == YAW_RATE:
        return observe_rate(state, measurement, c)
    if measurement.kind == SLIPS:
        return observe_slips(state, measurement, c)
    return observe_weighed(state, measurement, c)
