# SPDX-License-Identifier: Apache-2.0
"""One soil's drive as the estimator takes it: what all runs on the soil have in common.

Runs differ in their noise. The rounding of the encoders belongs to the drive: it is the same for all.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackslip_common.errors import InputError
from trackslip_estimation.slip.batch import Log
from trackslip_estimation.slip.measurement_log import read_measurements
from trackslip_estimation.slip.measurements import Measurement, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip.models.model import SPROCKETS, YAW_RATE
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_sim.study.slip.parameters import NODE, Cell, StudyParameters
from trackslip_sim.truth.record import Truth
from trackslip_sim.truth.simulate import simulate
from trackslip_tools.replay.scoring import MOVING

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Drive:
    """Rows in the order of their stamps, after the fix at time 0 from which the filters start."""

    truth: Truth  # at the rows
    rows: Log  # values and noises are each cell's own
    true_speeds: FloatArray  # (k, 3) as the log's, from angles that are not rounded
    told: tuple[FloatArray, FloatArray]  # (k, 2) rad/s, (k,) s: what slips are told by, over which stretch
    samples: IntArray  # rows of the sprocket samples: there the estimator publishes
    scored: IntArray  # (s,) those of them after settling
    moving: BoolArray  # (s,) whether the slips mean something
    turning: BoolArray  # (s,) moving, and in a turn

    @property
    def fixes(self) -> BoolArray:
        """(k,) rows of poses."""
        fixes: BoolArray = (self.rows.flags[:, 0] != SPROCKETS) & ~self.rates
        return fixes

    @property
    def rates(self) -> BoolArray:
        """(k,) rows of the gyro."""
        rates: BoolArray = self.rows.flags[:, 0] == YAW_RATE
        return rates

    @property
    def fix_size(self) -> int:
        """3, or 2 where the heading is not used."""
        return int(self.rows.flags[self.fixes, 0].max())  # the kinds are numbered so

    def log(self, cell: Cell, sigma_heading: float) -> Log:
        """The rows with the noises of a cell; values are each run's own."""
        noises = np.zeros_like(self.rows.noises)
        noises[self.fixes] = np.diag(np.square(fix_deviations(cell, sigma_heading)))
        noises[self.rates, 0, 0] = cell.sigma_omega**2
        return self.rows._replace(noises=noises)


def fix_deviations(cell: Cell, sigma_heading: float) -> FloatArray:
    """(3,) of a fix in x, y, heading."""
    return np.array((cell.sigma_xy, cell.sigma_xy, sigma_heading))


def make_drive(p: StudyParameters, estimator: SlipEstimatorParameters, soil: str) -> Drive:
    """The scenario on the shear truth of a soil.

    Raises:
        InputError: scenario, soil or sources are refused, or after settling nothing moves.
    """
    scenario = load_scenario(p.scenario).stretched(p.duration)
    truth = simulate(scenario, soil=soil, vehicle=estimator.vehicle)
    end = int(truth.duration * p.sprocket_rate + 1e-6) / p.sprocket_rate
    sprockets = list(_sprockets(truth, p, end, estimator.encoder_resolution))
    found = [*sprockets, *_rates(p.gyro_rate, end, estimator), *_fixes(p, end, estimator)]
    rows = _read(found, estimator)
    at = truth.interpolate(np.cumsum(rows.times[:, 0]))
    samples = np.flatnonzero(rows.flags[:, 0] == SPROCKETS)
    scored = samples[at.t[samples] > p.settling]
    moving = _moving(at, estimator)[scored]
    if not moving.any():
        raise InputError(
            f"{NODE}: after {p.settling:g} s of settling nothing moves in '{p.scenario}' on {soil}"
        )
    return Drive(
        truth=at,
        rows=rows,
        true_speeds=_true_speeds(truth, at, rows, 1.0 / p.sprocket_rate),
        told=_told(sprockets, estimator, p, rows),
        samples=samples,
        scored=scored,
        moving=moving,
        turning=moving & (rows.flags[scored, 2] == Motion.TURNING),
    )


def _told(
    sprockets: list[Measurement], estimator: SlipEstimatorParameters, p: StudyParameters, rows: Log
) -> tuple[FloatArray, FloatArray]:
    """What slips are told by at the sprocket samples: what a gyro would be predicted with just there."""
    end = sprockets[-1].stamp_ns * 1e-9
    found = [*sprockets, *_rates(p.sprocket_rate, end, estimator), *_fixes(p, 0.0, estimator)]
    probed = _read(found, estimator)
    probes, samples = probed.flags[:, 0] == YAW_RATE, rows.flags[:, 0] == SPROCKETS
    speeds, stretches = rows.speeds[:, :2].copy(), rows.times[:, 1].copy()
    speeds[samples], stretches[samples] = probed.speeds[probes, :2], probed.times[probes, 1]
    return speeds, stretches


def _read(found: list[Measurement], estimator: SlipEstimatorParameters) -> Log:
    log = read_measurements(found, estimator)
    if log.asides:
        raise InputError(
            f"{NODE}: sprocket_rate: the estimator takes the time between two samples for silence"
        )
    return log.log


def _sprockets(truth: Truth, p: StudyParameters, end: float, resolution: float) -> Iterator[Measurement]:
    """Positions in whole counts."""
    times = np.arange(round(end * p.sprocket_rate) + 1) / p.sprocket_rate
    at = truth.interpolate(times)
    angles = np.stack((at.left_angle, at.right_angle), axis=1)
    counted = np.floor(angles / resolution) * resolution if resolution > 0.0 else angles
    for t, (left, right) in zip(times.tolist(), counted.tolist(), strict=True):
        yield Sprockets("sprockets", _ns(t), 0.0, 0.0, (left, right))


def _rates(rate: float, end: float, estimator: SlipEstimatorParameters) -> Iterator[Measurement]:
    """Empty ones."""
    source = _first(estimator.gyros(), "yaw_rate_sources")
    for k in range(1, int(end * rate + 1e-6) + 1):
        yield YawRate(source, _ns(k / rate), 0.0, 1.0)


def _fixes(p: StudyParameters, end: float, estimator: SlipEstimatorParameters) -> Iterator[Measurement]:
    """Empty ones, from time 0 on."""
    source = _first(estimator.poses(), "pose_sources")
    covariance = np.diag((1.0, 1.0, p.sigma_heading**2))
    for k in range(int(end * p.fix_rate + 1e-6) + 1):
        yield PoseFix(source, _ns(k / p.fix_rate), np.zeros(3), covariance)


def _first(sources: Mapping[str, object], name: str) -> str:
    if not sources:
        raise InputError(f"{NODE}: {name}: none; accepted: one or more")
    return next(iter(sources))


def _ns(t: float) -> int:
    return round(t * 1e9)


def _true_speeds(truth: Truth, at: Truth, rows: Log, period: float) -> FloatArray:
    """(k, 3) left and right over the stretch between samples in which a row lies, and the log's departure."""
    ends = np.ceil(at.t / period - 1e-6) * period
    before, after = truth.interpolate(ends - period), truth.interpolate(ends)
    left, right = after.left_angle - before.left_angle, after.right_angle - before.right_angle
    return np.stack((left / period, right / period, rows.speeds[:, 2]), axis=1)


def _moving(at: Truth, estimator: SlipEstimatorParameters) -> BoolArray:
    """Whether the machine moves, as when a replay is scored, and each track runs: else slips say nothing."""
    vehicle = estimator.vehicle
    on_ground = np.abs(at.v_x) + np.abs(at.yaw_rate) * vehicle.tread / 2.0 > MOVING
    slower = vehicle.rolling_radius * np.minimum(np.abs(at.left_speed), np.abs(at.right_speed))
    moving: BoolArray = on_ground & (slower > MOVING)
    return moving
