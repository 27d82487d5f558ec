# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Setup check of a running slip estimator, reported in /diagnostics as ``setup``."""

from collections.abc import Callable

from rclpy.clock import Clock, ClockType

from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.health import OK, WARN, Health
from trackslip_estimation.setup_check.finding import Result
from trackslip_estimation.setup_check.running import BackgroundCheck, RunningCheck
from trackslip_estimation.slip.measurements import Command, Input, Reload
from trackslip_estimation.slip.parameters import SlipEstimatorParameters

PART = "setup"
_PERIOD = 15.0  # s between evaluations
_MOST_CAUSES = 3  # causes named in one message


class SetupMonitor:
    """Collects each input of the estimator; evaluates in its own thread, so that no measurement waits."""

    def __init__(
        self, node: TrackslipNode[SlipEstimatorParameters], on_failure: Callable[[Exception], None]
    ) -> None:
        self._node = node
        self._running = RunningCheck(node.settings)
        self._background = BackgroundCheck(self._running, on_failure)
        node.create_timer(_PERIOD, self._evaluate, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def add_input(self, estimator_input: Input) -> None:
        """Add an input of the estimator; a reload restarts the check."""
        if isinstance(estimator_input, Command | Reload):
            if isinstance(estimator_input, Reload):
                self._running.restart(self._node.settings)
        else:
            self._running.add(estimator_input)

    def finish(self) -> None:
        """Wait for a running evaluation."""
        self._background.join()

    def health(self) -> list[Health]:
        """Return the entry of the setup check."""
        return [setup_health(self._running.result)]

    def _evaluate(self) -> None:
        if self._node.active:
            self._background.start()


def setup_health(result: Result) -> Health:
    """Return the entry: plausible, the causes with remedies, or mistakes whose cause is one of several."""
    values = {cause.cause: f"{cause.evidence}. {cause.remedy}" for cause in result.causes}
    values |= {f"not decided: {question.what}": question.needed for question in result.undetermined}
    if result.is_plausible:
        return Health(OK, "no setup mistake found", values, PART)
    if not result.causes:
        return Health(WARN, result.headline, values, PART)
    first, *others = result.causes
    words = [f"{first.cause} ({first.source}): {first.evidence}. {first.remedy}"]
    words += [
        f"also {cause.cause} ({cause.source}): {cause.evidence}" for cause in others[: _MOST_CAUSES - 1]
    ]
    return Health(WARN, "; ".join(words), values, PART)
