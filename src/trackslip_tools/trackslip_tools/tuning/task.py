# SPDX-License-Identifier: Apache-2.0
"""One bag as the tuner sees it: read once, scored for any set of parameters.

    ν, S    innovation of a measurement, its covariance
    d²      νᵀ S⁻¹ ν
    m       degrees of freedom
    ε, u    share of measurements that are wrong, and their density wherever they may lie

The likelihood of a measurement is (1 − ε) N(ν; 0, S) + ε u: what no noise explains costs so much and no more,
so that one spike does not outweigh a drive, and a filter that refuses everything scores badly.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_estimation.slip.batch import BoolArray, Run
from trackslip_estimation.slip.measurement_log import MeasurementLog, read_measurements, reread, run_log
from trackslip_estimation.slip.measurements import Measurement
from trackslip_estimation.slip.models.model import FULL_POSE, POSE, POSITION, SPROCKETS, YAW_RATE
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_tools.replay.dead_reckoning import Path
from trackslip_tools.replay.scoring import nees_of_each, score
from trackslip_tools.tuning.plan import changed

FloatArray = NDArray[np.float64]

_WRONG = 1e-3  # ε
_AREA, _RATES = 1e4, 2.0 * math.pi  # m², rad/s: where wrong measurements lie
_DENSITIES = {YAW_RATE: 1.0 / _RATES, POSITION: 1.0 / _AREA, FULL_POSE: 1.0 / (_AREA * 2.0 * math.pi)}  # u
_SCORED = 2000  # samples of a reference, spread evenly, that tell as much as all


class Score(NamedTuple):
    """How well a set of parameters does on a bag; errors are nan where it has no reference."""

    log_likelihood: float  # mean of a measurement
    nis: dict[str, float]  # source → mean d²/m of what was taken, 1 if honest
    rejected: dict[str, int]  # source → how many
    position: float  # m, RMS error
    heading: float  # rad, RMS error
    nees: float  # mean of the pose's, 3 if honest
    pose_log_likelihood: float  # mean of the reference's poses, by what the filter claims of its own


@dataclass(frozen=True, eq=False)
class Task:
    """A bag, and the parameters that tuning starts from."""

    name: str
    measurements: list[Measurement]
    p: SlipEstimatorParameters
    log: MeasurementLog  # read with them
    reference: Path | None

    def score(self, values: Mapping[str, float]) -> Score:
        """With other values of some parameters (dotted names).

        Raises:
            InputError: a value is refused.
        """
        p = changed(self.p, values)
        log = reread(self.log, self.measurements, p, values)
        keep = self._around_reference(log)
        result = run_log(log, p, keep)
        innovations = _innovations(log, result, list(p.timeouts_ns()))
        return Score(*innovations, *self._errors(log.stamps_ns[keep], result))

    def _around_reference(self, log: MeasurementLog) -> BoolArray:
        """(k,) the published rows next to the samples of the reference."""
        keep = np.zeros(len(log.log.times), dtype=np.bool_)
        published = np.flatnonzero(log.published)
        if self.reference is not None and published.size:
            after = np.searchsorted(log.stamps_ns[published], self.reference.stamps_ns)
            keep[published[np.clip(after, 0, published.size - 1)]] = True
            keep[published[np.clip(after - 1, 0, published.size - 1)]] = True
        return keep

    def _errors(self, stamps_ns: NDArray[np.int64], result: Run) -> tuple[float, float, float, float]:
        """The last four of a ``Score``."""
        if self.reference is None or not len(stamps_ns):
            return math.nan, math.nan, math.nan, math.nan
        poses = result.means[:, POSE].copy()
        poses[:, 2] = np.unwrap(poses[:, 2])
        path = Path(stamps_ns, poses)
        errors = score(path, self.reference)
        nees, log_dets = nees_of_each(path, result.covariances[:, POSE, POSE], self.reference)
        if errors is None:
            return math.nan, math.nan, math.nan, math.nan
        likelihood = -0.5 * float(np.mean(nees + log_dets)) - 1.5 * math.log(2.0 * math.pi)
        return errors.position, errors.heading, float(np.mean(nees)), likelihood


def make_task(
    name: str, measurements: list[Measurement], p: SlipEstimatorParameters, reference: Path | None
) -> Task:
    """A bag's measurements, read.

    Raises:
        InputError: there is none to start from.
    """
    if reference is not None:
        every = -(-len(reference.stamps_ns) // _SCORED) or 1
        reference = Path(reference.stamps_ns[::every], reference.poses[::every])
    return Task(name, measurements, p, read_measurements(measurements, p), reference)


def _innovations(
    log: MeasurementLog, result: Run, sources: list[str]
) -> tuple[float, dict[str, float], dict[str, int]]:
    """The first three of a ``Score``."""
    dof, number = log.log.flags[:, 0], log.log.flags[:, 1]  # the kinds are numbered so
    measured = dof > SPROCKETS
    normal = -0.5 * (result.nis + result.log_dets + dof * math.log(2.0 * math.pi)) + math.log1p(-_WRONG)
    normal[np.isnan(normal)] = -np.inf
    wrong = np.log([_WRONG * _DENSITIES.get(kind, 1.0) for kind in range(FULL_POSE + 1)])
    mixed = np.logaddexp(normal[measured], wrong[dof[measured]])
    nis, rejected = {}, {}
    for k, source in enumerate(sources):
        of = measured & (number == k)
        taken = of & result.accepted
        if of.any():
            rejected[source] = int(of.sum() - taken.sum())
            nis[source] = float(result.nis[taken].sum() / max(dof[taken].sum(), 1))
    return float(mixed.mean()) if mixed.size else -math.inf, nis, rejected
