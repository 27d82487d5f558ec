# SPDX-License-Identifier: Apache-2.0
"""A bag as arrays: what calibration needs of it, by stamp, in seconds from the bag's first message."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_bags.reader import Bag, require_topics
from trackslip_bags.tables import read_tables
from trackslip_common.errors import InputError
from trackslip_common.message_fields import (
    RECORDS,
    HydraulicsFields,
    ImuFields,
    OdometryFields,
    PoseFields,
    RecordClass,
    SprocketFields,
    dtype_of,
    poses_of,
)
from trackslip_estimation.slip.motion import Motion, MotionParameters, MotionState, Speeds, classify
from trackslip_tools.replay.inputs import SPROCKETS

FloatArray = NDArray[np.float64]
Rows = NDArray[np.void]

HYDRAULICS = "hydraulics"


class Series(NamedTuple):
    """Readings in the order of their stamps."""

    t: FloatArray  # (n,) s
    values: FloatArray  # (n, k)


@dataclass(frozen=True, eq=False)
class Recording:
    """One drive; what the bag lacks is empty."""

    name: str
    sprockets: Series  # left, right: rad, continuous
    gyro: Series  # about x, y, z of the unit: rad/s, as it gives them
    poses: Series  # x m, y m, heading rad (continuous); the variances that are claimed for them
    hydraulics: Series  # left, right: Pa; left, right spool (nan where there is none)
    motion: NDArray[np.int64]  # (n,) Motion at each sprocket sample

    def turned(self) -> FloatArray:
        """(n,) integral of the gyro's rate about its z axis, at its stamps, rad; bias and all."""
        t, rates = self.gyro
        steps = np.diff(t) * (rates[1:, 2] + rates[:-1, 2]) / 2.0
        return np.concatenate(([0.0], np.cumsum(steps)))[: len(t)]

    def angles_at(self, t: FloatArray) -> FloatArray:
        """(n, 2) of the left and right sprocket at other times, rad."""
        known, angles = self.sprockets
        return np.column_stack([np.interp(t, known, column) for column in angles.T])


def read_recording(bag: Bag, gyro: str, poses: str, limits: MotionParameters) -> Recording:
    """Read the sprockets, the gyro and the pose source of these names, and the hydraulics.

    Raises:
        InputError: the bag lacks the sprockets, or a topic is of a type that does not serve.
    """
    require_topics(bag, [SPROCKETS])
    driven = _integrated(_series(bag, SPROCKETS, SprocketFields, _sprockets))
    fixes = _series(bag, poses, PoseFields, _poses)
    fixes.values[:, 2] = np.unwrap(fixes.values[:, 2])
    return Recording(
        bag.path.name,
        driven,
        _series(bag, gyro, ImuFields, _rates),
        fixes,
        _series(bag, HYDRAULICS, HydraulicsFields, _hydraulics),
        motions(driven, limits),
    )


def motions(sprockets: Series, limits: MotionParameters) -> NDArray[np.int64]:
    """(n,) standing, straight or turning at each sample; unknown at the first."""
    t, angles = sprockets
    state, found = MotionState(), [int(Motion.UNKNOWN)]
    for dt, (left, right) in zip(np.diff(t).tolist(), np.diff(angles, axis=0).tolist(), strict=True):
        state = classify(state, Speeds(left / dt, right / dt, dt, differenced=True), dt, limits)
        found.append(int(state.motion))
    return np.array(found[: len(t)], dtype=np.int64)


def _series(bag: Bag, topic: str, kind: RecordClass, values_of: Callable[[Rows], FloatArray]) -> Series:
    """One topic by stamp, the first of each stamp; readings that are no numbers are left out."""
    parts = [np.empty(0, dtype_of(kind))]
    for stretch in read_tables(bag, [topic] if topic else []):
        for table in stretch.values():
            if RECORDS.get(table.type_name) not in _ACCEPTED[kind]:
                accepted = " or ".join(name for name, known in RECORDS.items() if known in _ACCEPTED[kind])
                raise InputError(f"bag '{bag.path}': {topic} is a {table.type_name}; accepted: {accepted}")
            parts.append(table.rows(kind))
    rows = np.concatenate(parts)
    values = values_of(rows)
    sound = np.isfinite(values[:, :2]).all(axis=1)
    stamps_ns, first = np.unique(rows["stamp_ns"][sound], return_index=True)
    return Series((stamps_ns - bag.start_ns) * 1e-9, values[sound][first])


def _sprockets(rows: Rows) -> FloatArray:
    """(n, 4) left and right speed, left and right position."""
    positions = np.column_stack((rows["left_position"], rows["right_position"]))
    positions[~rows["has_positions"]] = np.nan
    return np.column_stack((rows["left_speed"], rows["right_speed"], positions))


def _rates(rows: Rows) -> FloatArray:
    """(n, 3) about x, y, z."""
    return np.column_stack((rows["rate_x"], rows["rate_y"], rows["rate_z"]))


def _poses(rows: Rows) -> FloatArray:
    """(n, 6) x, y, heading and their variances."""
    return np.column_stack((poses_of(rows), np.diagonal(rows["covariance"], axis1=1, axis2=2)))


def _hydraulics(rows: Rows) -> FloatArray:
    """(n, 4) left and right pressure, left and right spool."""
    names = ("left_pressure", "right_pressure", "left_spool", "right_spool")
    return np.column_stack([rows[name] for name in names])


def _integrated(readings: Series) -> Series:
    """Angles: the positions, or where any is missing the integral of the speeds."""
    t, values = readings
    if np.isfinite(values[:, 2:]).all():
        return Series(t, values[:, 2:])
    steps = values[1:, :2] * np.diff(t)[:, np.newaxis]
    return Series(t, np.concatenate((np.zeros((1, 2)), np.cumsum(steps, axis=0))))


_ACCEPTED: dict[RecordClass, tuple[RecordClass, ...]] = {
    SprocketFields: (SprocketFields,),
    ImuFields: (ImuFields,),
    PoseFields: (PoseFields, OdometryFields),  # which have the same pose
    HydraulicsFields: (HydraulicsFields,),
}
