# SPDX-License-Identifier: Apache-2.0
"""The estimator's inputs as numpy records: whole batches of them go into compiled code.

``ARRIVAL`` is a ``MEASUREMENT`` of the estimator, with what a bag knows beside it:

    kind           of ``slip.records``, or IS_COMMAND, IS_RELOAD
    source         number of the source, in ``InputStream.sources``
    stamp_ns       of the measurement; 0 where there is none
    log_time_ns    of its message
    reload         IS_RELOAD: number in ``InputStream.reloads``
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.message_fields import (
    ImuFields,
    OrientationFields,
    PoseFields,
    QuaternionFields,
    RecordClass,
    SlipFields,
    SprocketFields,
    headings_of,
    poses_of,
)
from trackslip_estimation.slip.measurements import SET_POSE
from trackslip_estimation.slip.records import HEADING, MANUAL, MEASUREMENT, POSE, SLIPS, SPROCKETS, YAW_RATE
from trackslip_estimation.slip.sources import HEADING_MESSAGES

Rows = NDArray[np.void]

IS_COMMAND, IS_RELOAD = HEADING + 1, HEADING + 2  # more kinds: its source is the command; new parameters

_FIELDS = MEASUREMENT.names or ()
ARRIVAL = np.dtype(
    [*((n, MEASUREMENT[n]) for n in _FIELDS), ("log_time_ns", np.int64), ("reload", np.int64)], align=True
)


class SourceReader(NamedTuple):
    """How the messages of a source become rows."""

    kind: int
    fields: RecordClass  # record class that is read
    default_variance: float = 0.0  # of a yaw rate or a heading that states none

    def rows(self, read: Rows) -> Rows:
        """(n,) ARRIVAL, without source and log time, of (n,) records of ``fields``."""
        rows = np.zeros(len(read), ARRIVAL)
        rows["kind"], rows["stamp_ns"] = self.kind, read["stamp_ns"]
        _FILL[self.kind](rows, read, self.default_variance)
        return rows


SPROCKET_READER = SourceReader(SPROCKETS, SprocketFields)
POSE_READER = SourceReader(POSE, PoseFields)
SLIP_READER = SourceReader(SLIPS, SlipFields)


def yaw_rate_reader(default_variance: float) -> SourceReader:
    """Of a source of yaw rates, (rad/s)² where a message states no variance (REP-145)."""
    return SourceReader(YAW_RATE, ImuFields, default_variance)


def heading_reader(type_name: str, default_variance: float) -> SourceReader:
    """Of a source of headings, whose messages are of this type; rad² where one states no variance."""
    is_imu = type_name == HEADING_MESSAGES["imu"]
    return SourceReader(HEADING, OrientationFields if is_imu else QuaternionFields, default_variance)


def to_measurements(rows: Rows, sources: Sequence[str], numbers: Mapping[str, int]) -> Rows:
    """(n,) MEASUREMENT of (n,) ARRIVAL from ``sources``; ``numbers``: those that the estimator gives them."""
    found = np.empty(len(rows), MEASUREMENT)
    for name in _FIELDS:
        found[name] = rows[name]
    own = np.array([MANUAL if name == SET_POSE else numbers.get(name, 0) for name in sources])
    found["source"] = own[rows["source"]]
    return found


def _fill_sprockets(rows: Rows, read: Rows, _: float) -> None:
    for side in ("left", "right"):
        rows[f"{side}_speed"] = read[f"{side}_speed"]
        rows[f"{side}_angle"] = np.where(read["has_positions"], read[f"{side}_position"], np.nan)


def _fill_yaw_rates(rows: Rows, read: Rows, default_variance: float) -> None:
    rows["value"][:, 0] = read["rate_z"]
    rows["noise"][:, 0, 0] = np.where(read["variance_z"] == 0.0, default_variance, read["variance_z"])


def _fill_poses(rows: Rows, read: Rows, _: float) -> None:
    rows["value"], rows["noise"] = poses_of(read), read["covariance"]


def _fill_slips(rows: Rows, read: Rows, _: float) -> None:
    rows["value"][:, :2] = np.column_stack((read["left_slip"], read["right_slip"]))
    rows["noise"][:, :2, :2] = read["slips_covariance"]


def _fill_headings(rows: Rows, read: Rows, default_variance: float) -> None:
    rows["value"][:, 0], rows["noise"][:, 0, 0] = headings_of(read), default_variance
    if "absent" in (read.dtype.names or ()):
        rows["value"][read["absent"] == -1.0, 0] = np.nan
        stated = read["variance_z"] != 0.0
        rows["noise"][stated, 0, 0] = read["variance_z"][stated]


_FILL: dict[int, Callable[[Rows, Rows, float], None]] = {
    SPROCKETS: _fill_sprockets,
    YAW_RATE: _fill_yaw_rates,
    POSE: _fill_poses,
    SLIPS: _fill_slips,
    HEADING: _fill_headings,
}
