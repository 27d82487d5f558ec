# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Weigh a heading, as of a pair of antennas, under one branch, and update with it; compiled.

    ν, S   z − φ, wrapped, and its variance                rad, rad²

A pair of antennas errs by much when it fixes its ambiguities wrongly, and states a small variance. Whether it
errs then, or the heading of the machine is wrong, is for the bank to weigh (``bank``).
"""

import math
from typing import Any

import numpy as np

from trackslip_common.compiled import inlined
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.slip.events import IS_OFFSET, IS_SCATTERING, latest_pose_source
from trackslip_estimation.slip.fixes import correct_angle, weigh
from trackslip_estimation.slip.levers import stamp_shift, to_delayed, to_sensor, turn_heading
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.model import SWING, YAW
from trackslip_estimation.slip.observation import observed
from trackslip_estimation.slip.own_errors import to_offset

_GATED = int(Outcome.GATED)
_LOG_UNIFORM = -math.log(2.0 * math.pi)
_BY_PLACE = 0.05  # rad, standard deviation of a heading beyond which its correction turns about the antenna


@inlined
def use_heading(state: Any, measurement: Any, c: Any, update: Any) -> None:
    """See the top of the module; arguments as in ``update``."""
    source, limit, fault = measurement.source, c.gate_limits[1], state.fault[measurement.source]
    z, stated = observed(measurement, state, c)
    x, P, shift = state.mean[: c.size].copy(), state.covariance.copy(), stamp_shift(state, source, c)
    if c.above[source] == 1:
        z += x[SWING]  # which its offset has
    place = latest_pose_source(state, c) if P[YAW, YAW] > _BY_PLACE**2 else -1
    if place >= 0 and c.above[place] == c.above[source]:
        to_sensor(x, P, state.attitude.level, place, 1.0, c)
    else:
        place = -1
        turn_heading(x, P, source, 1.0, c)
    to_delayed(x, P, shift, 1.0)
    if fault == IS_OFFSET:
        to_offset(x, P, source, 1.0, c)
    innovation = np.array((wrap(z[0] - x[YAW]),))
    predicted = P[YAW : YAW + 1, YAW : YAW + 1].copy()
    R, used, _ = weigh(state, measurement, innovation, predicted, stated, False, _LOG_UNIFORM, c, update)
    if fault == IS_SCATTERING:
        update.evidence, update.outcome = _LOG_UNIFORM, _GATED
    if not used or fault == IS_SCATTERING:
        return
    correct_angle(x, P, YAW, innovation, R, limit)
    if fault == IS_OFFSET:
        to_offset(x, P, source, -1.0, c)
        update.outcome = _GATED
    to_delayed(x, P, shift, -1.0)
    x[YAW] = wrap(x[YAW])
    if place >= 0:
        to_sensor(x, P, state.attitude.level, place, -1.0, c)
    else:
        turn_heading(x, P, source, -1.0, c)
    state.mean[: c.size], state.covariance[:] = x, P
