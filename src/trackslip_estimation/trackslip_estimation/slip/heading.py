# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Gate and update with a heading, as of a pair of antennas; compiled.

    ν, S   z − φ, wrapped, and its variance                rad, rad²
    g, w   limit of the gate, and how far it has widened   (``gate``)
    f      factor of the source's variance                 (``adaptation``)

Inside g it is used in full, up to the soft gate with less weight, as a fix. Beyond it is refused: a pair of
antennas errs by much when it fixes its ambiguities wrongly, and claims to be good. A source that insists for
long enough is believed, and the heading was wrong. Where the heading is not known yet, it is known now.
"""

import math
from typing import Any

import numpy as np

from trackslip_common.compiled import compiled, inlined
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.slip.adaptation import learn_from_fix
from trackslip_estimation.slip.alignment import RigidMotion, forget_fixes, keep_refused, move_pose
from trackslip_estimation.slip.levers import sensor_place, stamp_shift, to_delayed, to_sensor, turn_heading
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import SWING, YAW, X, Y
from trackslip_estimation.slip.models.swing import may_swing, open_swing
from trackslip_estimation.slip.observation import observed
from trackslip_estimation.slip.update import correct, width_of

_GATED = int(Outcome.GATED)


@inlined
def use_heading(state: Any, measurement: Any, c: Any, update: Any) -> None:
    """See the top of the module; arguments as in ``update``."""
    source, limit = measurement.source, c.gate_limits[1]
    soft = c.adaptation.soft_gate * limit
    z, stated = observed(measurement, state, c)
    x, P, shift = state.mean[: c.size].copy(), state.covariance.copy(), stamp_shift(state, source, c)
    if c.above[source] == 1:
        z += x[SWING]  # which its offset has
    turn_heading(x, P, source, 1.0, c)
    to_delayed(x, P, shift, 1.0)
    innovation = np.array((wrap(z[0] - x[YAW]),))
    predicted = P[YAW : YAW + 1, YAW : YAW + 1].copy()
    update.dof, update.gate = 1, soft * width_of(state, measurement, c)
    if state.aligning:
        spread = P[SWING, SWING] if c.above[source] == 1 else 0.0
        _align(state, innovation[0], stated[0, 0] + spread, c)
        state.consistent_ns[source], update.follows = measurement.stamp_ns, False
        return
    factors = state.adaptation.fix_factors
    if has_velocity_errors(c) and innovation[0] ** 2 <= soft * (predicted + factors[source] * stated)[0, 0]:
        learn_from_fix(state.adaptation, source, innovation, predicted, stated, c)
    R = factors[source] * stated
    S = predicted[0, 0] + R[0, 0]
    update.nis, update.log_determinant = innovation[0] ** 2 / S, math.log(S)
    if update.nis > update.gate:
        update.outcome = _GATED
        return
    if update.nis <= limit:
        state.consistent_ns[source] = measurement.stamp_ns
    elif update.nis <= soft:
        R = R + (update.nis / limit - 1.0) * S
    elif may_swing(state, source, c):
        open_swing(state.covariance, c)
        update.outcome = _GATED
        return
    else:
        update.prior_covariance[YAW, YAW] += innovation[0] ** 2
        P[YAW, YAW] += innovation[0] ** 2
    correct(measurement.kind, x, P, (x[YAW : YAW + 1] + innovation, R), (0.0, 0.0), c)
    to_delayed(x, P, shift, -1.0)
    x[YAW] = wrap(x[YAW])
    turn_heading(x, P, source, -1.0, c)
    state.mean[: c.size], state.covariance[:] = x, P


@compiled
def _align(state: Any, rotation: float, variance: float, c: Any) -> None:
    """The heading is found: the pose turns by ``rotation`` about the latest fix of an antenna."""
    if state.refused_count == 0:  # none since the start
        x, P = state.mean[: c.size].copy(), state.covariance.copy()
        latest = _latest(state, c)
        lever = sensor_place(state.attitude.level, x[SWING], latest, c)
        to_sensor(x, P, state.attitude.level, latest, 1.0, c)
        variance_of_fix = max((P[X, X] + P[Y, Y]) / 2.0 - lever[0] ** 2 - lever[1] ** 2, 0.0)
        keep_refused(state, (x[X], x[Y]), (x[X], x[Y]), variance_of_fix)
    fix, count = state.refused[state.refused_count - 1], state.refused_count
    origin, target = (fix.predicted_x, fix.predicted_y), (fix.x, fix.y)
    move_pose(state, RigidMotion(rotation, math.sqrt(variance), 0.0, origin, target, count * fix.variance))
    state.aligning = False
    forget_fixes(state, False)


@compiled
def _latest(state: Any, c: Any) -> int:
    """Number of the source of poses with a lever arm that was consistent last; 0 where none has one."""
    latest = -1
    for k in range(c.levers.shape[0]):
        has_lever = c.levers[k, 0] != 0.0 or c.levers[k, 1] != 0.0
        if has_lever and (latest < 0 or state.consistent_ns[k] > state.consistent_ns[latest]):
            latest = k
    return max(latest, 0)
