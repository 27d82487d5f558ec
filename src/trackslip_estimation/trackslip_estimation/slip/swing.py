# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Weigh an angle of the upper structure under one branch, and update with it; compiled.

    σ, σ̇   angle of the upper structure and its rate        rad, rad/s
    ν, S    z − σ, wrapped, and its variance                rad, rad²

The update is made in the coordinates of a source of poses above, if there is one: what that saw is the place
and heading of the sensor, and both stay as they were seen while σ becomes known.
"""

import math
from typing import Any

import numpy as np

from trackslip_common.compiled import compiled, inlined
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.slip.events import IS_SCATTERING
from trackslip_estimation.slip.fixes import correct_angle, weigh
from trackslip_estimation.slip.levers import to_sensor
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.model import SWING, SWING_RATE
from trackslip_estimation.slip.observation import observed

_GATED = int(Outcome.GATED)
_LOG_UNIFORM = -math.log(2.0 * math.pi)


@inlined
def use_swing(state: Any, measurement: Any, c: Any, update: Any) -> None:
    """See the top of the module; arguments as in ``update``."""
    source, level = measurement.source, state.attitude.level
    z, stated = observed(measurement, state, c)
    x, P = state.mean[: c.size].copy(), state.covariance.copy()
    innovation, predicted = np.array((wrap(z[0] - x[SWING]),)), P[SWING:SWING_RATE, SWING:SWING_RATE].copy()
    R, used, _ = weigh(state, measurement, innovation, predicted, stated, False, _LOG_UNIFORM, c, update)
    if state.fault[source] == IS_SCATTERING:
        update.evidence, update.outcome = _LOG_UNIFORM, _GATED
    if not used or state.fault[source] == IS_SCATTERING:
        return
    if c.swing_place >= 0:
        to_sensor(x, P, level, c.swing_place, 1.0, c)
    correct_angle(x, P, SWING, innovation, R, c.gate_limits[1])
    if c.swing_place >= 0:
        to_sensor(x, P, level, c.swing_place, -1.0, c)
    state.mean[: c.size], state.covariance[:] = x, P


@compiled
def fill_swing(state: Any, swing: Any, c: Any) -> None:
    """What is published of the upper structure, into a record of ``SWINGING``."""
    swing.known, swing.angle, swing.rate = 0, 0.0, 0.0
    swing.covariance[:] = 0.0
    if c.swings:
        swing.known, swing.rate = 1, state.mean[SWING_RATE]
        swing.angle = wrap(state.mean[SWING])
        swing.covariance[:] = state.covariance[SWING : SWING_RATE + 1, SWING : SWING_RATE + 1]
