# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A heading by two antennas or a compass, valid δ σ_t before its stamp; compiled.

    z    measured direction, rad
    h    φ + direction of the sensor's axis in base_link (with the swing if mounted above) + b − δ σ_t φ̇
    b    yaw offset of the source (``source_offsets``)                                      rad

Two antennas with wrongly fixed ambiguities have a large error and a small stated variance. The bank weighs
such an error against an error of the machine's heading.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.kalman.update import Observation
from trackslip_estimation.slip.levers import horizontal_direction, stamp_shift
from trackslip_estimation.slip.models.model import FIX_DELAY, SWING, YAW
from trackslip_estimation.slip.validity import LEAST_VARIANCE

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord, State


@compiled
def compass_offset(state: State, source: int, c: Config) -> float:
    """Direction that a compass measures, against the heading of the machine, in the horizontal plane, rad."""
    offset = c.heading_offset[source]
    if c.above[source] == 1:
        offset += state.mean[SWING]
    return horizontal_direction(offset, state.attitude.level)


@compiled
def observe_heading(state: State, measurement: MeasurementRecord, c: Config) -> Observation:
    """ν (1,), H and R of a heading."""
    source, x, shift = measurement.source, state.mean[: c.size], stamp_shift(state, measurement.source, c)
    H, nu = np.zeros((1, x.size)), measurement.value[0] - x[YAW] - compass_offset(state, source, c)
    H[0, YAW], H[0, FIX_DELAY] = 1.0, -shift[YAW]
    nu += shift[YAW] * x[FIX_DELAY]
    if c.above[source] == 1:
        H[0, SWING] = 1.0
    index = c.yaw_offsets[source]
    if index >= 0:
        H[0, index] = 1.0
        nu -= x[index]
    R = max(measurement.noise[0, 0], c.heading_floor[source] ** 2, LEAST_VARIANCE)
    return Observation(np.array((wrap(nu),)), H, np.array(((R,),)), 0, 0, H[:0])
