# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Shapes about the path: ellipses of uncertainty, and the box where the laser found it."""

import numpy as np
from numpy.typing import NDArray

from trackslip_estimation.slip.measurements import Outcome
from trackslip_tools.report import plan_shapes
from trackslip_tools.report.run import Run, States

FloatArray = NDArray[np.float64]

BOX_SOURCE = "box_pose"
_ELLIPSES, _BOXES = 90, 30  # over the whole run


def ellipses(states: States) -> FloatArray:
    """(k, 33, 2) closed outlines of 2σ of the position, evenly spread over the time."""
    chosen = _spread(len(states.path.stamps_ns), _ELLIPSES)
    return plan_shapes.ellipses(states.path.poses[chosen, :2], states.pose_covariances[chosen, :2, :2])


def boxes(run: Run) -> FloatArray:
    """(k, 5, 2) closed outlines of the box by fixes that were accepted, evenly spread over them."""
    fixes = fixes_of(run).get(BOX_SOURCE)
    sensors = run.parameters.vehicle.sensors
    if fixes is None or sensors is None or sensors.box is None:
        return np.empty((0, 5, 2))
    return np.array(
        [plan_shapes.box_outline(sensors.box, pose) for pose in fixes[_spread(len(fixes), _BOXES)]]
    )


def fixes_of(run: Run) -> dict[str, FloatArray]:
    """By source: (n, 3) poses of the fixes that were accepted."""
    fixes = run.details.fixes
    fixes = fixes[fixes["outcome"] == Outcome.ACCEPTED]
    by_source = {
        run.details.sources[number]: fixes["source"] == number for number in np.unique(fixes["source"])
    }
    return {source: fixes["value"][own] for source, own in sorted(by_source.items())}


def _spread(size: int, wanted: int) -> NDArray[np.intp]:
    """Up to ``wanted`` indices, evenly spread from the first to the last."""
    return np.unique(np.linspace(0, size - 1, min(size, wanted)).round().astype(np.intp))
