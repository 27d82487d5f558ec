# SPDX-License-Identifier: Apache-2.0
"""The estimates that a whole log gives: at each time from what came before and after it.

The slip estimator runs over the measurements with a window as long as the log, so that every state is
settled; then ``filters.smoother`` goes back over its states. Where one state does not follow from the one
before it by the model (a start, a user's word for the pose, sprockets that were silent) nothing is carried
back: each piece is smoothed by itself. The filter is the extended Kalman filter, whichever the parameters
name.

All states are kept in memory, some 20 MB for each minute of a log.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import NamedTuple

from trackslip_estimation.kalman.smoother import Step
from trackslip_estimation.kalman.smoother import smooth as smooth_steps
from trackslip_estimation.slip.estimator import Estimate, SlipEstimator
from trackslip_estimation.slip.filter import Filter
from trackslip_estimation.slip.measurements import KINDS, Input, Measurement, Sprockets
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, make_filter
from trackslip_estimation.slip.stepping import FilterState
from trackslip_estimation.slip.timeline import key_of

Shown = Callable[[list[Measurement]], Iterable[Measurement]]

_FOREVER_NS = 2**62


class Smoothed(NamedTuple):
    """Estimates at the stamps of the sprocket samples, in their order; of both the same number."""

    filtered: list[Estimate]  # settled: from all that has an earlier stamp
    smoothed: list[Estimate]  # from all there is


def smooth(measurements: Iterable[Input], p: SlipEstimatorParameters, shown: Shown = iter) -> Smoothed:
    """Filter and smoother over a log, its measurements in any order; empty where nothing starts the estimate.

    What was asked of the estimator while it ran (to begin anew, to hold still, new parameters) is left out.
    ``shown`` wraps what the filter goes through, for a progress bar.
    """
    p = replace(p, filter="ekf")
    taken: list[Measurement] = sorted((m for m in measurements if isinstance(m, KINDS)), key=key_of)
    estimator = SlipEstimator(p, window_ns=_FOREVER_NS)
    for measurement in shown(taken):
        estimator.take(measurement)
    states = estimator.history()
    sources = {m.source for m in taken if isinstance(m, Sprockets)}
    wanted = [k for k, state in enumerate(states) if state.report and state.report.source in sources]
    after = _smoothed(states, make_filter(p))
    return Smoothed(
        [estimator.estimate_of(states[k]) for k in wanted], [estimator.estimate_of(after[k]) for k in wanted]
    )


def _smoothed(states: list[FilterState], filter_: Filter) -> list[FilterState]:
    """The states with what came later in them too."""
    steps = []
    before_ns = states[0].stamp_ns if states else 0
    for state in states:
        predicted = None if state.silent else state.predicted
        dt = (state.stamp_ns - before_ns) * 1e-9
        steps.append(Step(predicted, state.gaussian, state.speeds, state.motion.motion, dt))
        before_ns = state.stamp_ns
    smoothed = smooth_steps(steps, filter_)
    return [state._replace(gaussian=gaussian) for state, gaussian in zip(states, smoothed, strict=True)]
