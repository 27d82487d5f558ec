# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A measured angle of the upper structure against the undercarriage; compiled.

z    measured angle, rad
h    σ + its mounting + b
b    offset of the source (``source_offsets``), rad
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.kalman.update import Observation, independent_observation
from trackslip_estimation.slip.models.model import SWING
from trackslip_estimation.slip.validity import LEAST_VARIANCE

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord, State


@compiled
def observe_swing(state: State, measurement: MeasurementRecord, c: Config) -> Observation:
    """ν (1,), H and R of an angle."""
    index, H = c.yaw_offsets[measurement.source], np.eye(1, c.size, SWING)
    nu = measurement.value[0] - c.heading_offset[measurement.source] - state.mean[SWING]
    if index >= 0:
        H[0, index] = 1.0
        nu -= state.mean[index]
    R = max(measurement.noise[0, 0], LEAST_VARIANCE)
    return independent_observation(np.array((wrap(nu),)), H, np.array(((R,),)))
