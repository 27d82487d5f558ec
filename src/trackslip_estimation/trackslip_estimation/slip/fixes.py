# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fixes: gate, noise and update; compiled. Arguments as in ``update``.

    z, R   a fix, and its noise as it is used     (m,), (m, m)
    x, P   the state in the coordinates of the fix: its place is that of the sensor, its stamp error ago, with
           what lasts of the fix's error

What is refused leaves mean and covariance as they were. As tracks start, or turn back, fixes teach nothing of
their delay: the soil under them gives way first, which looks alike.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled, inlined
from trackslip_estimation.kalman import ekf
from trackslip_estimation.kalman.linear_algebra import log_determinant, root, weighted_square, wrap
from trackslip_estimation.slip.adaptation import learn_from_fix, repeats, shared_error
from trackslip_estimation.slip.alignment import (
    UNKNOWN_HEADING,
    compass_agrees,
    forget_refused,
    hold_place,
    insists,
    keep_refused,
    realign,
)
from trackslip_estimation.slip.levers import stamp_shift, to_delayed, to_sensor
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import FIX_DELAY, YAW, X, Y
from trackslip_estimation.slip.models.shear import starts
from trackslip_estimation.slip.models.swing import may_swing, open_swing
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.observation import observed
from trackslip_estimation.slip.own_errors import lasts, meet_quality, to_erring, white
from trackslip_estimation.slip.slides import find_slide
from trackslip_estimation.slip.stands import count_fix, stands_still
from trackslip_estimation.slip.traction import along_heading, changed_slip, goes_on, widen_slip

FloatArray = NDArray[np.float64]

_GATED, _STANDING = int(Outcome.GATED), int(Motion.STANDING)


@inlined
def use_pose(state: Any, measurement: Any, c: Any, update: Any) -> None:
    """Update with a pose: in full inside the gate g, with less weight up to the soft gate, not at all beyond.

    In between R grows until the innovation is as large as g allows. Silence widens P, never the gate; what is
    refused moves the pose where it agrees with others that were (``alignment``).
    """
    source = measurement.source
    z, stated = observed(measurement, state, c)
    m, limit = z.size, c.gate_limits[z.size]
    if lasts(source, c):
        meet_quality(state, update, source, stated, c)
    x, P, shift = state.mean[: c.size].copy(), state.covariance.copy(), stamp_shift(state, source, c)
    to_sensor(x, P, state.attitude.level, source, 1.0, c)
    to_delayed(x, P, shift, 1.0)
    update.dof, update.gate = m, c.adaptation.soft_gate * limit
    finds_heading = state.aligning and (m <= YAW or c.above[source] == 1)
    known = repeats(measurement.stamp_ns - state.consistent_ns[source], c.repeat_times[source])
    whole, alone = _noise(state, source, (_innovation(z, x), P[:m, :m].copy(), stated), finds_heading, c)
    to_erring(x, P, source, whole, 1.0, c)
    innovation, R = _innovation(z, x), white(whole, source, c)
    if not finds_heading:
        _follow_traction(state, source, (innovation, known * R), P, update, c)
    root_of_S = root(P[:m, :m] + R)
    nis = weighted_square(root_of_S, innovation)
    update.nis, update.log_determinant = nis, log_determinant(root_of_S)
    refused, inside = finds_heading or nis > update.gate, not finds_heading and nis <= limit
    if inside:
        state.consistent_ns[source] = measurement.stamp_ns
    elif _insists(state, measurement, (x, P), (z, whole, R), refused, c):
        update.follows = False
        return
    if finds_heading and _holds(state, source, innovation[:YAW], (P[:YAW, :YAW], R[:YAW, :YAW]), update, c):
        state.consistent_ns[source] = measurement.stamp_ns
        return
    if refused:
        update.outcome = _GATED
        return
    if nis > limit:
        R += (nis / limit - 1.0) * (P[:m, :m] + R)
    R *= min(known, shared_error(P[:m, :m], R))
    count_fix(state, source, alone, R, c)
    kept = FIX_DELAY if has_velocity_errors(c) and starts(state, c) else -1
    ekf.correct_keeping(x, P, innovation, (np.eye(m, x.size), R), kept)
    state.runs[source].pulled += along_heading(state, innovation) - along_heading(state, z - x[:m])
    to_erring(x, P, source, whole, -1.0, c)
    to_delayed(x, P, shift, -1.0)
    x[YAW] = wrap(x[YAW])
    to_sensor(x, P, state.attitude.level, source, -1.0, c)
    state.mean[: c.size], state.covariance[:] = x, P
    state.aligning = state.aligning and P[YAW, YAW] > UNKNOWN_HEADING**2
    if inside:
        forget_refused(state, True)


@inlined
def _holds(
    state: Any,
    source: int,
    innovation: FloatArray,
    variances: tuple[FloatArray, FloatArray],
    update: Any,
    c: Any,
) -> bool:
    """Whether a fix is inside its gate while no heading is known: it moves the place, and nothing else.

    ``variances``: P and R (2, 2) of the sensor's place.
    """
    shift, after = np.zeros(YAW), variances[0].copy()
    nis, logarithm = ekf.correct(shift, after, innovation, np.eye(YAW), variances[1].copy())
    gate = c.adaptation.soft_gate * c.gate_limits[YAW]
    if nis > gate:
        return False
    update.nis, update.log_determinant, update.gate = nis, logarithm, gate
    update.dof, update.follows = YAW, False
    lever = c.levers[source, 0] ** 2 + c.levers[source, 1] ** 2
    for i in range(YAW):
        after[i, i] += lever
    hold_place(state, shift, after)
    return True


@compiled
def _innovation(z: FloatArray, x: FloatArray) -> FloatArray:
    """(m,) ν of a fix: it measures the first numbers of the state as they are."""
    nu = z - x[: z.size]
    if z.size > YAW:
        nu[YAW] = wrap(nu[YAW])
    return nu


@inlined
def _follow_traction(
    state: Any, source: int, shown: tuple[FloatArray, FloatArray], P: FloatArray, update: Any, c: Any
) -> None:
    """P and the prior with a change of slip that a run of fixes may show; ``shown``: ν and R of this one."""
    nu, R = shown
    m = nu.size
    predicted = P[:m, :m].copy()
    if weighted_square(root(predicted + R), nu) > update.gate:
        return
    changed = changed_slip(state, source, (along_heading(state, nu), predicted, R), c)
    if changed[0] != 0.0:
        widen_slip(state, P, changed)
        widen_slip(state, update.prior_covariance[:], changed)


@inlined
def _insists(
    state: Any,
    measurement: Any,
    known: tuple[FloatArray, FloatArray],
    fix: tuple[FloatArray, FloatArray, FloatArray],
    refused: bool,
    c: Any,
) -> bool:
    """Whether a fix outside its gate, with others that were refused, moved the pose.

    ``known``: x and P; ``fix``: z, R as stated, and without what lasts of its error.
    """
    source, (x, P), (z, whole, R) = measurement.source, known, fix
    m, limit = z.size, c.gate_limits[z.size]
    if may_swing(state, source, c):
        forget_refused(state, False)  # how it swings is no way that was driven
        silent_ns = measurement.stamp_ns - state.consistent_ns[source]
        if refused and not state.aligning and silent_ns > c.timeouts_ns[source]:
            open_swing(state.covariance, c)
        return False
    keep_refused(state, (x[X], x[Y]), (z[X], z[Y]), (whole[X, X] + whole[Y, Y]) / 2.0)
    heading_fits = m <= YAW or _innovation(z, x)[YAW] ** 2 <= limit * (P[YAW, YAW] + R[YAW, YAW])
    at_rest = heading_fits and insists(state, source, measurement.stamp_ns, c)
    shown = heading_fits if m > YAW else compass_agrees(state, measurement.stamp_ns, c)
    moved = (shown and find_slide(state, c)) or realign(state, at_rest, shown, c)
    if moved:
        state.consistent_ns[source] = measurement.stamp_ns
    return bool(moved)


@inlined
def _noise(
    state: Any,
    source: int,
    shown: tuple[FloatArray, FloatArray, FloatArray],
    finds_heading: bool,
    c: Any,
) -> tuple[FloatArray, bool]:
    """R of a fix, whose factor is learned from it; whether it counts alone, or as one more of its stand.

    ``shown``: its innovation, the covariance of that without R, and R as stated.
    """
    innovation, predicted, stated = shown
    factors, limit = state.adaptation.fix_factors, c.gate_limits[innovation.size]
    nis = weighted_square(root(predicted + factors[source] * stated), innovation)
    alone = not stands_still(state, source, c) or nis > limit
    inside = nis <= c.adaptation.soft_gate * limit
    same_side = goes_on(state.runs[source], along_heading(state, innovation))
    if has_velocity_errors(c) and not finds_heading and inside and alone and not same_side:
        learn_from_fix(state.adaptation, source, innovation, predicted, stated, c)
        if lasts(source, c) or c.repeat_times[source] > 0.0:  # that it is followed well shows nothing
            factors[source] = max(factors[source], 1.0)
    return factors[source] * stated, alone
