# SPDX-License-Identifier: Apache-2.0
"""The slip estimator over an ordinary log in one go: the same reports and estimates, to the last bit.

A log is ordinary where nobody asked anything of the estimator, every measurement is usable and in time, no
sprocket sample is late, and the sprockets are never silent and do not jump. All others go one by one.
"""

from collections.abc import Sequence
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from trackslip_estimation.slip.arrivals import Arrivals, Passed, Stretches, run_arrivals
from trackslip_estimation.slip.estimator import Estimate, SlipEstimator, make_estimate
from trackslip_estimation.slip.measurements import (
    SET_POSE,
    Input,
    Measurement,
    Outcome,
    PoseFix,
    Report,
    Sprockets,
    YawRate,
)
from trackslip_estimation.slip.models.model import Gaussian, Outputs
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, make_gates
from trackslip_estimation.slip.timeline import key_of

Steps = list[tuple[Report, Estimate | None]]
IntArray = NDArray[np.int64]

_MOTIONS = tuple(Motion)


def quick_steps(inputs: Sequence[Input], p: SlipEstimatorParameters) -> Steps | None:
    """What ``SlipEstimator.advance`` gives for each input; None where the log is not ordinary."""
    if not _only_measurements(inputs):
        return None
    estimator = SlipEstimator(p)
    steps: Steps = []
    for given in inputs:
        if estimator.started:
            break
        steps.append(estimator.advance(given))
    if not estimator.started or not all(map(estimator.is_usable, inputs)):
        return None
    first, rest = inputs[: len(steps)], inputs[len(steps) :]
    taken = [estimator.prepared(m) for m in rest]
    if len(set(map(key_of, taken))) < len(taken):
        return None
    begin = estimator.history()[0]
    samples = [m for m in (*first, *taken) if isinstance(m, Sprockets)]
    known = sum(isinstance(m, Sprockets) for m in first)
    sample_ns = np.array([m.stamp_ns for m in samples], dtype=np.int64) - begin.stamp_ns
    arrivals = _arrivals(taken, estimator, begin.stamp_ns)
    stretches = _stretches(samples, sample_ns, known, p)
    if stretches is None or not _in_time(arrivals, stretches, p):
        return None
    m = p.motion
    passed = run_arrivals(
        arrivals,
        stretches,
        estimator.stepper.filter,
        begin.gaussian,
        np.array(
            (m.standing_speed, m.turning_ratio, m.change_ratio, m.hysteresis, m.smoothing_time, m.memory_time)
        ),
        make_gates(p),
    )
    return steps + _told(taken, arrivals.sources[:, 0].tolist(), passed)


def _only_measurements(inputs: Sequence[Input]) -> TypeGuard[Sequence[Measurement]]:
    return all(isinstance(m, (Sprockets, YawRate, PoseFix)) and m.source != SET_POSE for m in inputs)


def _arrivals(taken: Sequence[Measurement], estimator: SlipEstimator, origin_ns: int) -> Arrivals:
    numbers = {name: number for number, name in enumerate(estimator.parameters.timeouts_ns())}
    count = len(taken)
    keys = [key_of(m) for m in taken]
    places = np.empty(count, np.int64)
    places[sorted(range(count), key=keys.__getitem__)] = np.arange(count)
    arrivals = Arrivals(
        places,
        np.array([m.stamp_ns for m in taken], dtype=np.int64) - origin_ns,
        np.zeros((count, 2), np.int64),
        np.zeros((count, 3)),
        np.zeros((count, 3, 3)),
    )
    for k, m in enumerate(taken):
        if not isinstance(m, Sprockets):
            kind, value, noise = estimator.stepper.measured(m, silent=False)
            arrivals.sources[k] = kind, numbers[m.source]
            arrivals.values[k, : value.size] = value
            arrivals.noises[k, : value.size, : value.size] = noise
    return arrivals


def _stretches(
    samples: Sequence[Sprockets], stamps_ns: IntArray, known: int, p: SlipEstimatorParameters
) -> Stretches | None:
    """None where positions are missing, jump, or a stretch holds silence."""
    if len(samples) < 2 or any(m.positions is None for m in samples):
        return None
    turned = np.array([m.positions for m in samples])
    steps_ns = np.diff(stamps_ns)
    if steps_ns.min() <= 0 or steps_ns.max() > _hold_ns(p):
        return None
    stretches = np.zeros((len(samples), 3))
    stretches[1:, 2] = steps_ns * 1e-9
    stretches[1:, :2] = np.diff(turned, axis=0) / stretches[1:, 2:]
    sound = np.abs(stretches[:, :2]).max() <= p.max_sprocket_speed
    return Stretches(stamps_ns, stretches, known) if sound else None


def _in_time(arrivals: Arrivals, stretches: Stretches, p: SlipEstimatorParameters) -> bool:
    """Whether each measurement lies between the second sprocket sample and where their speeds no longer hold,
    and within the window when it comes.
    """
    stamps_ns, is_sample = arrivals.stamps_ns, arrivals.sources[:, 0] == 0
    newest = np.maximum.accumulate(np.concatenate(([0], stamps_ns)))[:-1]
    heads = stretches.stamps_ns[stretches.known + np.cumsum(is_sample) - 1]
    window_ns = round(p.history_window * 1e9)
    return bool(
        stretches.known >= 2
        and (stamps_ns > 0).all()
        and (stamps_ns > stretches.stamps_ns[1]).all()
        and (stamps_ns >= newest - window_ns).all()
        and (stamps_ns <= heads + _hold_ns(p)).all()
    )


def _hold_ns(p: SlipEstimatorParameters) -> int:
    """How long a sprocket sample holds: there is neither silence nor a clock that jumps ahead."""
    return min(round(p.sprocket_timeout * 1e9), round(p.max_gap * 1e9))


def _told(taken: Sequence[Measurement], dofs: list[int], passed: Passed) -> Steps:
    """Reports and estimates; ``dofs`` are the degrees of freedom of the measurements."""
    steps: Steps = []
    nis, gates = passed.nis.tolist(), passed.gates.tolist()
    accepted, motions = passed.accepted.tolist(), passed.motions.tolist()
    told = zip(passed.twists, passed.twist_covariances, passed.slips, passed.slip_covariances, strict=True)
    for k, (m, outputs) in enumerate(zip(taken, told, strict=True)):
        if isinstance(m, Sprockets):
            state = Gaussian(passed.poses[k], passed.pose_covariances[k])
            estimate = make_estimate(m.stamp_ns, state, Outputs(*outputs), _MOTIONS[motions[k]])
            steps.append((Report(m.source, m.stamp_ns, Outcome.ACCEPTED), estimate))
        else:
            outcome = Outcome.ACCEPTED if accepted[k] else Outcome.GATED
            steps.append((Report(m.source, m.stamp_ns, outcome, nis[k], gates[k], dofs[k]), None))
    return steps
