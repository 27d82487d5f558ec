# SPDX-License-Identifier: Apache-2.0
"""The estimator's inputs as numpy records: whole batches of them go into compiled code.

Fields of ``ARRIVAL``; those that a kind does not name are zero.

    kind           Kind
    source         number of the source, in ``InputStream.sources``
    stamp_ns       of the measurement; 0 where there is none
    log_time_ns    of its message
    speeds         SPROCKETS: left, right                                     rad/s
    positions      SPROCKETS: left, right, nothing unless has_positions       rad
    z, R           YAW_RATE: rate, variance in z[0], R[0, 0]                  rad/s
                   POSE_FIX: x, y, heading; covariance                        m, m, rad
                   SLIP_FIX: left, right in z[:2]; covariance in R[:2, :2]    1
    reload         RELOAD: number in ``InputStream.reloads``
"""

from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.message_fields import (
    ImuFields,
    PoseFields,
    RecordClass,
    SlipFields,
    SprocketFields,
    poses_of,
)
from trackslip_estimation.slip.measurements import (
    Command,
    Input,
    PoseFix,
    Reload,
    SlipFix,
    Sprockets,
    YawRate,
)

Rows = NDArray[np.void]

ARRIVAL = np.dtype(
    [
        ("kind", np.uint8),
        ("has_positions", np.bool_),
        ("source", np.int16),
        ("reload", np.int32),
        ("stamp_ns", np.int64),
        ("log_time_ns", np.int64),
        ("speeds", np.float64, 2),
        ("positions", np.float64, 2),
        ("z", np.float64, 3),
        ("R", np.float64, (3, 3)),
    ],
    align=True,
)


class Kind(IntEnum):
    """What a row of ``ARRIVAL`` is."""

    SPROCKETS = 0
    YAW_RATE = 1
    POSE_FIX = 2
    SLIP_FIX = 3
    COMMAND = 4  # its source is the command
    RELOAD = 5


class SourceReader(NamedTuple):
    """How the messages of a source become rows."""

    kind: Kind
    fields: RecordClass  # record class that is read
    default_variance: float = 0.0  # of a yaw rate that states none

    def rows(self, read: Rows) -> Rows:
        """(n,) ARRIVAL, without source and log time, of (n,) records of ``fields``."""
        rows = np.zeros(len(read), ARRIVAL)
        rows["kind"], rows["stamp_ns"] = self.kind, read["stamp_ns"]
        _FILL[self.kind](rows, read, self.default_variance)
        return rows


SPROCKET_READER = SourceReader(Kind.SPROCKETS, SprocketFields)
POSE_READER = SourceReader(Kind.POSE_FIX, PoseFields)
SLIP_READER = SourceReader(Kind.SLIP_FIX, SlipFields)


def yaw_rate_reader(default_variance: float) -> SourceReader:
    """Of a source of yaw rates, (rad/s)² where a message states no variance (REP-145)."""
    return SourceReader(Kind.YAW_RATE, ImuFields, default_variance)


def inputs_of(rows: Rows, sources: Sequence[str], reloads: Sequence[Reload] = ()) -> list[Input]:
    """The rows as the estimator's own measurements and commands."""
    names = [sources[number] for number in rows["source"].tolist()]
    kinds, stamps_ns = rows["kind"].tolist(), rows["stamp_ns"].tolist()
    speeds, has_positions = rows["speeds"].tolist(), rows["has_positions"].tolist()
    positions, numbers = rows["positions"].tolist(), rows["reload"].tolist()
    z, R = rows["z"], rows["R"]
    found: list[Input] = []
    for k, (kind, source, stamp_ns) in enumerate(zip(kinds, names, stamps_ns, strict=True)):
        if kind == Kind.SPROCKETS:
            (left, right), turned = speeds[k], tuple(positions[k]) if has_positions[k] else None
            found.append(Sprockets(source, stamp_ns, left, right, turned))
        elif kind == Kind.YAW_RATE:
            found.append(YawRate(source, stamp_ns, float(z[k, 0]), float(R[k, 0, 0])))
        elif kind == Kind.POSE_FIX:
            found.append(PoseFix(source, stamp_ns, z[k].copy(), R[k].copy()))
        elif kind == Kind.SLIP_FIX:
            found.append(SlipFix(source, stamp_ns, z[k, :2].copy(), R[k, :2, :2].copy()))
        else:
            found.append(reloads[numbers[k]] if kind == Kind.RELOAD else Command(source, stamp_ns))
    return found


def _fill_sprockets(rows: Rows, read: Rows, _: float) -> None:
    rows["speeds"] = np.column_stack((read["left_speed"], read["right_speed"]))
    rows["has_positions"] = read["has_positions"]
    positions = np.column_stack((read["left_position"], read["right_position"]))
    rows["positions"] = np.where(read["has_positions"][:, np.newaxis], positions, 0.0)


def _fill_yaw_rates(rows: Rows, read: Rows, default_variance: float) -> None:
    rows["z"][:, 0] = read["rate_z"]
    rows["R"][:, 0, 0] = np.where(read["variance_z"] == 0.0, default_variance, read["variance_z"])


def _fill_poses(rows: Rows, read: Rows, _: float) -> None:
    rows["z"], rows["R"] = poses_of(read), read["covariance"]


def _fill_slips(rows: Rows, read: Rows, _: float) -> None:
    rows["z"][:, :2] = np.column_stack((read["left_slip"], read["right_slip"]))
    rows["R"][:, :2, :2] = read["slips_covariance"]


_FILL: dict[Kind, Callable[[Rows, Rows, float], None]] = {
    Kind.SPROCKETS: _fill_sprockets,
    Kind.YAW_RATE: _fill_yaw_rates,
    Kind.POSE_FIX: _fill_poses,
    Kind.SLIP_FIX: _fill_slips,
}
