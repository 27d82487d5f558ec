# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""One bag for the tuner: read once, scored for any set of parameters.

    ν, S    innovation of a measurement, its covariance
    d²      νᵀ S⁻¹ ν
    m       degrees of freedom
    ε, u    share of outliers, and their uniform density

The likelihood of a measurement is (1 − ε) N(ν; 0, S) + ε u. The cost of an outlier is therefore bounded: one
spike does not outweigh a drive, and a filter that rejects everything scores badly.
"""

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import Bag
from trackslip_common.arrays import BoolArray, IntArray
from trackslip_common.errors import InputError
from trackslip_estimation.slip.log import Log, make_log, run_log
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.model import POSE
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.records import SPROCKETS
from trackslip_estimation.slip.window import Records
from trackslip_tools.replay.run import default_reference
from trackslip_tools.replay.scoring import PathErrors, path_of_series
from trackslip_tools.replay.series import Path
from trackslip_tools.replay.sorted_inputs import read_sorted_inputs
from trackslip_tools.tuning.plan import change_parameters

_OUTLIER_SHARE = 1e-3  # ε
_AREA, _RATES = 1e4, 2.0 * math.pi  # m², rad/s: range of outliers
_DENSITIES = np.array((1.0, 1.0 / _RATES, 1.0 / _AREA, 1.0 / (_AREA * 2.0 * math.pi)))  # u, by m
_MAX_REFERENCE_SAMPLES = 2000  # samples of a reference, evenly spread, that are enough for the scores


Job = tuple[int, Mapping[str, float]]
"""Number of the bag, values."""


class Score(NamedTuple):
    """Scores of a set of parameters on a bag; errors are nan without a reference."""

    log_likelihood: float  # mean over the measurements
    nis: dict[str, float]  # source → mean d²/m of accepted measurements, 1 if consistent
    rejected: dict[str, int]  # source → number of rejected measurements
    position: float  # m, RMS error
    heading: float  # rad, RMS error
    nees: float  # mean of the pose, 3 if consistent; of the position, 2, without headings
    pose_log_likelihood: float  # mean ln likelihood of the reference's poses under the filter's covariance


@dataclass(frozen=True, eq=False)
class Task:
    """A bag, and the parameters that tuning starts from."""

    name: str
    log: Log
    p: SlipEstimatorParameters
    reference: Path | None

    def score(self, values: Mapping[str, float]) -> Score:
        """Scores with other values of some parameters (dotted names).

        Raises:
            InputError: a value is rejected.
        """
        p, is_scored = change_parameters(self.p, values), self._is_near_reference()
        innovations = _Innovations(list(p.timeouts_ns()))
        means, covariances = [np.empty((0, 3))], [np.empty((0, 3, 3))]
        for block in run_log(self.log, p):
            stretch = slice(block.first, block.first + len(block.states))
            innovations.add(self.log.rest["source"][stretch], block.updates)
            means.append(block.states["mean"][is_scored[stretch]][:, POSE])
            covariances.append(block.states["covariance"][is_scored[stretch]][:, POSE, POSE])
        errors, poses = PathErrors(), np.concatenate(means)
        if self.reference is not None and len(poses):
            poses[:, 2] = np.unwrap(poses[:, 2])
            path = Path(self.log.rest["stamp_ns"][is_scored], poses)
            errors.compare(path, self.reference, np.concatenate(covariances))
        return Score(*innovations.score(), *_error_numbers(errors))

    @cached_property
    def fingerprint(self) -> str:
        """Hash of everything on which a score depends, except the values."""
        digest = hashlib.sha256(repr(self.p).encode())
        for array in self.log:
            digest.update(array.tobytes())
        if self.reference is not None:
            R = self.reference.covariances
            digest.update(self.reference.stamps_ns.tobytes() + self.reference.poses.tobytes())
            digest.update(b"" if R is None else R.tobytes())
        return digest.hexdigest()

    def _is_near_reference(self) -> BoolArray:
        """(k,) whether an entry is a sprocket sample (with an estimate) next to a sample of the reference."""
        rest = self.log.rest
        is_near = np.zeros(len(rest), dtype=np.bool_)
        published = np.flatnonzero(rest["kind"] == SPROCKETS)
        if self.reference is not None and published.size:
            after = np.searchsorted(rest["stamp_ns"][published], self.reference.stamps_ns)
            is_near[published[np.clip(after, 0, published.size - 1)]] = True
            is_near[published[np.clip(after - 1, 0, published.size - 1)]] = True
        return is_near


def _error_numbers(errors: PathErrors) -> tuple[float, float, float, float]:
    """The last four fields of a ``Score``."""
    score = errors.score
    position, heading = (None, None) if score is None else (score.position, score.heading)
    nees = errors.nees_position if heading is None else errors.nees
    numbers = (position, heading, nees, errors.log_likelihood)
    position, heading, nees, likelihood = (math.nan if one is None else one for one in numbers)
    return position, heading, nees, likelihood


def score_of(tasks: Sequence[Task], job: Job) -> Score:
    """Score of one set of parameters on one bag."""
    bag, values = job
    return tasks[bag].score(values)


def make_task(name: str, arrivals: Records, p: SlipEstimatorParameters, reference: Path | None) -> Task:
    """A task from a bag's measurements, records of ``MEASUREMENT``.

    Raises:
        InputError: no measurement can start the filter.
    """
    if reference is not None:
        stride = -(-len(reference.stamps_ns) // _MAX_REFERENCE_SAMPLES) or 1
        R = None if reference.covariances is None else reference.covariances[::stride]
        reference = Path(reference.stamps_ns[::stride], reference.poses[::stride], R)
    return Task(name, make_log(arrivals, p), p, reference)


class _Innovations:
    """Sums over the innovations of a run; sources are indices of ``names``."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names
        self._likelihood, self._count = 0.0, 0
        self._nis, self._dof, self._rejected, self._seen = np.zeros((4, len(names)))

    def add(self, sources: IntArray, updates: Records) -> None:
        """Add (k,) sources and (k,) updates."""
        is_measured = updates["dof"] > 0
        sources, measured_updates = sources[is_measured], updates[is_measured]
        dof, nis = measured_updates["dof"], measured_updates["nis"]
        normal = -0.5 * (nis + measured_updates["log_determinant"] + dof * math.log(2.0 * math.pi))
        normal += math.log1p(-_OUTLIER_SHARE)
        normal[np.isnan(normal)] = -np.inf
        self._likelihood += float(np.sum(np.logaddexp(normal, np.log(_OUTLIER_SHARE * _DENSITIES)[dof])))
        self._count += len(dof)
        has_source = sources < len(self._names)  # a manual pose has no source
        sources, nis, dof = sources[has_source], nis[has_source], dof[has_source]
        is_accepted = measured_updates["outcome"][has_source] == Outcome.ACCEPTED
        size = len(self._names)
        self._nis += np.bincount(sources[is_accepted], nis[is_accepted], size)
        self._dof += np.bincount(sources[is_accepted], dof[is_accepted], size)
        self._rejected += np.bincount(sources[~is_accepted], minlength=size)
        self._seen += np.bincount(sources, minlength=size)

    def score(self) -> tuple[float, dict[str, float], dict[str, int]]:
        """The first three fields of a ``Score``."""
        seen = [k for k, count in enumerate(self._seen) if count]
        mean_nis = {self._names[k]: float(self._nis[k] / max(self._dof[k], 1.0)) for k in seen}
        rejected = {self._names[k]: int(self._rejected[k]) for k in seen}
        return self._likelihood / self._count if self._count else -math.inf, mean_nis, rejected


def read_task(
    bag: Bag,
    p: SlipEstimatorParameters,
    filters: InputFilters,
    reference: str | None,
    *,
    needs_reference: bool,
) -> Task:
    """A task from a bag's measurements and, if there is one, its reference.

    Commands at run time are left out, except manual poses.

    Raises:
        InputError: the bag lacks a required topic.
    """
    reference = reference or default_reference(bag)
    requested = (reference,) if reference else ()
    measurements, series_of_topics = read_sorted_inputs(bag, p, filters, requested)
    series = series_of_topics.get(reference or "")
    if series is None and needs_reference:
        raise InputError(f"bag '{bag.path}': no reference for this objective; --reference TOPIC names one")
    return make_task(str(bag.path), measurements, p, None if series is None else path_of_series(series))
