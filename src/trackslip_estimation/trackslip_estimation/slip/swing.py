# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Gate and update with a sensor of the swing, and what a swing does to the gates of others; compiled.

    σ, σ̇   angle of the upper structure and its rate        rad, rad/s
    ν, S    z − σ, wrapped, and its variance                rad, rad²
    g, w    limit of the gate, and how far it has widened   (``gate``)

Inside g it is used in full, up to the soft gate with less weight. Beyond it is refused, and σ̇ counts as
unknown from then on: it swings although the tracks drive, or has started faster than it should. A sensor that
insists is believed. The update is made in the coordinates of a source of poses above, if there is one: what
that saw is the place and heading of the sensor, and both stay as they were seen while σ becomes known.
"""

import math
from typing import Any

import numpy as np

from trackslip_common.compiled import compiled, inlined
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.slip.adaptation import learn_from_fix
from trackslip_estimation.slip.alignment import UNKNOWN_HEADING
from trackslip_estimation.slip.levers import to_sensor
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.model import SWING, SWING_RATE, YAW
from trackslip_estimation.slip.observation import observed
from trackslip_estimation.slip.update import correct, width_of

_GATED = int(Outcome.GATED)


@inlined
def use_swing(state: Any, measurement: Any, c: Any, update: Any) -> None:
    """See the top of the module; arguments as in ``update``."""
    source, limit = measurement.source, c.gate_limits[1]
    soft = c.adaptation.soft_gate * limit
    z, stated = observed(measurement, state, c)
    x, P, level = state.mean[: c.size].copy(), state.covariance.copy(), state.attitude.level
    innovation, predicted = np.array((wrap(z[0] - x[SWING]),)), P[SWING:SWING_RATE, SWING:SWING_RATE].copy()
    update.dof, update.gate = 1, soft * width_of(state, measurement, c)
    factors = state.adaptation.fix_factors
    if innovation[0] ** 2 <= soft * (predicted + factors[source] * stated)[0, 0]:
        learn_from_fix(state.adaptation, source, innovation, predicted, stated, c)
    R = factors[source] * stated
    S = predicted[0, 0] + R[0, 0]
    update.nis, update.log_determinant = innovation[0] ** 2 / S, math.log(S)
    if update.nis > update.gate:
        update.outcome = _GATED
        state.covariance[SWING_RATE, SWING_RATE] += c.swing.fastest**2
        return
    if update.nis <= limit:
        state.consistent_ns[source] = measurement.stamp_ns
    elif update.nis <= soft:
        R = R + (update.nis / limit - 1.0) * S
    else:
        for i in range(SWING, SWING_RATE + 1):
            widened = innovation[0] ** 2 if i == SWING else c.swing.fastest**2
            P[i, i] += widened
            update.prior_covariance[i, i] += widened
    if c.swing_place >= 0:
        to_sensor(x, P, level, c.swing_place, 1.0, c)
    correct(measurement.kind, x, P, (x[SWING : SWING + 1] + innovation, R), (0.0, 0.0), c)
    x[YAW] = wrap(x[YAW])
    if c.swing_place >= 0:
        to_sensor(x, P, level, c.swing_place, -1.0, c)
    state.mean[: c.size], state.covariance[:] = x, P
    state.aligning = state.aligning and P[YAW, YAW] > UNKNOWN_HEADING**2


@compiled
def fill_swing(state: Any, swing: Any, c: Any) -> None:
    """What is published of the upper structure, into a record of ``SWINGING``."""
    swing.known, swing.angle, swing.rate = 0, 0.0, 0.0
    swing.covariance[:] = 0.0
    if c.swings:
        swing.known, swing.rate = 1, state.mean[SWING_RATE]
        swing.angle = wrap(state.mean[SWING])
        swing.covariance[:] = state.covariance[SWING : SWING_RATE + 1, SWING : SWING_RATE + 1]
