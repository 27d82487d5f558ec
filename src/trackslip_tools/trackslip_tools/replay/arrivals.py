# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The estimator's inputs as numpy records, which compiled code takes in batches.

``ARRIVAL`` is a ``MEASUREMENT`` of the estimator with further fields from the bag:

    kind           of ``slip.records``, or IS_COMMAND, IS_RELOAD, IS_START
    source         number of the source, in ``InputStream.sources``
    stamp_ns       of the measurement; 0 if there is none
    log_time_ns    of its message
    reload         IS_RELOAD: number in ``InputStream.reloads``; −1: nothing changes
    start          IS_RELOAD, IS_START: number in ``InputStream.starts``; −1: unknown
    part           of the bag that can be compared with live estimates, from 1 on; 0: none
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from trackslip_common.arrays import Rows
from trackslip_common.message_fields import (
    ABSENT,
    ImuFields,
    OdometryPoseFields,
    OrientationFields,
    PoseFields,
    QuaternionFields,
    SlipFields,
    SprocketFields,
    SwingFields,
    VelocityFields,
)
from trackslip_common.message_reading import RecordClass
from trackslip_common.orientations import headings_of, poses_of
from trackslip_estimation.slip.measurements import SET_POSE
from trackslip_estimation.slip.mounting import rotate, rotate_variances, vertical_axis
from trackslip_estimation.slip.records import (
    HEADING,
    MANUAL,
    MEASUREMENT,
    ODOMETRY,
    ON_SWING,
    POSE,
    SLIPS,
    SPROCKETS,
    VELOCITY,
    YAW_RATE,
)
from trackslip_estimation.slip.sources import (
    HEADING_MESSAGES,
    ODOMETRY_FIELDS,
    HeadingSource,
    OdometrySource,
    Rejection,
    SwingSource,
    VelocitySource,
    YawRateSource,
)

# Further kinds: a command (its source); new parameters; a restart of the estimator.
IS_COMMAND, IS_RELOAD, IS_START = VELOCITY + 1, VELOCITY + 2, VELOCITY + 3

_FIELDS = MEASUREMENT.names or ()
ARRIVAL = np.dtype(
    [
        *((n, MEASUREMENT[n]) for n in _FIELDS),
        *((n, np.int64) for n in ("log_time_ns", "reload", "start", "part")),
    ],
    align=True,
)


SourceParameters = YawRateSource | HeadingSource | SwingSource | OdometrySource | VelocitySource


class SourceReader(NamedTuple):
    """Converts the messages of a source to rows."""

    kind: int
    fields: RecordClass  # record class of the messages
    parameters: SourceParameters | None = None  # parameters of the source
    absent: tuple[str, Rejection] | None = None  # field whose ABSENT rejects a message, and the reason

    def rows(self, read: Rows) -> Rows:
        """(n,) ARRIVAL, without source and log time, of (n,) records of ``fields``."""
        rows = np.zeros(len(read), ARRIVAL)
        rows["kind"], rows["stamp_ns"] = self.kind, read["stamp_ns"]
        _FILL_FUNCTIONS[self.kind](rows, read, self.parameters)
        return rows


SPROCKET_READER = SourceReader(SPROCKETS, SprocketFields)
POSE_READER = SourceReader(POSE, PoseFields)
SLIP_READER = SourceReader(SLIPS, SlipFields)


def reader_of(source: SourceParameters, type_name: str = "") -> SourceReader:
    """Reader of a source with these parameters; ``type_name``: message type of a heading source."""
    match source:
        case YawRateSource():
            return SourceReader(YAW_RATE, ImuFields, source, ("variance_x", Rejection.NO_RATE))
        case HeadingSource() if type_name == HEADING_MESSAGES["imu"]:
            return SourceReader(HEADING, OrientationFields, source, ("absent", Rejection.NO_ORIENTATION))
        case HeadingSource():
            return SourceReader(HEADING, QuaternionFields, source)
        case SwingSource():
            return SourceReader(ON_SWING, SwingFields, source)
        case OdometrySource():  # caller fills in the numbers of frames
            _, field, rejection = ODOMETRY_FIELDS[source.covariance]
            return SourceReader(ODOMETRY, OdometryPoseFields, source, (field, rejection) if field else None)
        case _:
            return SourceReader(VELOCITY, VelocityFields, source, ("absent", Rejection.NO_VELOCITY))


def to_measurements(rows: Rows, sources: Sequence[str], numbers: Mapping[str, int]) -> Rows:
    """(n,) MEASUREMENT of (n,) ARRIVAL from ``sources``; ``numbers``: source numbers of the estimator."""
    measurements = np.empty(len(rows), MEASUREMENT)
    for name in _FIELDS:
        measurements[name] = rows[name]
    number_of_source = np.array([MANUAL if name == SET_POSE else numbers.get(name, 0) for name in sources])
    measurements["source"] = number_of_source[rows["source"]]
    return measurements


def _fill_sprockets(rows: Rows, read: Rows, _: object) -> None:
    for side in ("left", "right"):
        rows[f"{side}_speed"] = read[f"{side}_speed"]
        rows[f"{side}_angle"] = np.where(read["has_positions"], read[f"{side}_position"], np.nan)


def _fill_yaw_rates(rows: Rows, read: Rows, imu: YawRateSource) -> None:
    """Fill yaw rates, equal to ``conversions.yaw_rate`` to the last bit."""
    R, default_variance = imu.mounting, imu.stddev**2
    variances = [read[f"variance_{axis}"] for axis in "xyz"]
    p, q, r = rotate(R, [read[f"rate_{axis}"] for axis in "xyz"])
    rotated_variances = rotate_variances(R, [np.where(v != 0.0, v, default_variance) for v in variances])
    rows["value"] = np.column_stack((r, p, q))
    for k, variance in enumerate((rotated_variances[2], *rotated_variances[:2])):
        rows["noise"][:, k, k] = variance
    x, y, z = (read[f"acceleration_variance_{axis}"] for axis in "xyz")
    present, mean = x != ABSENT, (x + y + z) / 3.0
    a = np.column_stack(rotate(R, [read[f"acceleration_{axis}"] for axis in "xyz"]))
    rows["acceleration"] = np.where(present[:, None], a, np.nan)
    mean = np.where(mean != 0.0, mean, imu.acceleration_stddev**2)
    rows["acceleration_variance"] = np.where(present, mean, np.nan)
    rows["up"] = rows["up_variances"] = np.nan
    if imu.use_orientation:
        rows["up"] = np.column_stack(rotate(R, vertical_axis(*(read[f"q{axis}"] for axis in "xyzw"))))
        variances = [read[f"orientation_variance_{axis}"] for axis in "xyz"]
        up_variances = np.column_stack(rotate_variances(R, variances)[:2])
        rows["up_variances"] = np.where(variances[0][:, None] != ABSENT, up_variances, ABSENT)


def _fill_poses(rows: Rows, read: Rows, _: object) -> None:
    rows["value"], rows["noise"] = poses_of(read), read["covariance"]
    rows["altitude"], rows["altitude_variance"] = read["z"], read["z_variance"]


def _fill_slips(rows: Rows, read: Rows, _: object) -> None:
    rows["value"][:, :2] = np.column_stack((read["left_slip"], read["right_slip"]))
    rows["noise"][:, :2, :2] = read["slips_covariance"]


def _fill_headings(rows: Rows, read: Rows, compass: HeadingSource) -> None:
    rows["value"][:, 0], rows["noise"][:, 0, 0] = compass.from_east(headings_of(read)), compass.stddev**2
    if "absent" in (read.dtype.names or ()):
        has_variance = read["variance_z"] != 0.0
        rows["noise"][has_variance, 0, 0] = read["variance_z"][has_variance]


def _fill_swings(rows: Rows, read: Rows, angle: SwingSource) -> None:
    rows["value"][:, 0], rows["noise"][:, 0, 0] = read["angle"], angle.stddev**2


def _fill_odometry(rows: Rows, read: Rows, odometry: OdometrySource) -> None:
    rows["value"] = np.column_stack([read[name] for name in "xyz"])
    rows["orientation"] = np.column_stack([read[f"q{axis}"] for axis in "xyzw"])
    name = ODOMETRY_FIELDS[odometry.covariance][0]
    if name:
        rows["noise"][:, :2] = read[name]


def _fill_velocities(rows: Rows, read: Rows, velocity: VelocitySource) -> None:
    """Fill velocities, equal to ``conversions.velocity_fix`` to the last bit."""
    rows["stamp_ns"] -= velocity.latency_ns
    rows["value"][:, 0], rows["value"][:, 1] = read["v_x"], read["v_y"]
    rows["noise"][:, :2, :2] = read["covariance"]
    for i in range(2):
        variances = rows["noise"][:, i, i]
        rows["noise"][:, i, i] = np.where(variances != 0.0, variances, velocity.stddev**2)


_FILL_FUNCTIONS: dict[int, Callable[[Rows, Rows, Any], None]] = {
    SPROCKETS: _fill_sprockets,
    YAW_RATE: _fill_yaw_rates,
    POSE: _fill_poses,
    SLIPS: _fill_slips,
    HEADING: _fill_headings,
    ODOMETRY: _fill_odometry,
    ON_SWING: _fill_swings,
    VELOCITY: _fill_velocities,
}
