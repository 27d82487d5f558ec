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
        self, node: TrackslipNode[SlipEstimatorParameters], failed: Callable[[Exception], None]
    ) -> None:
        self._node = node
        self._running = RunningCheck(node.settings)
        self._background = BackgroundCheck(self._running, failed)
        node.create_timer(_PERIOD, self._evaluate, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def add_input(self, given: Input) -> None:
        """Add an input of the estimator; a reload restarts the check."""
        if isinstance(given, Command | Reload):
            if isinstance(given, Reload):
                self._running.restart(self._node.settings)
        else:
            self._running.add(given)

    def finish(self) -> None:
        """Wait for a running evaluation."""
        self._background.join()

    def health(self) -> list[Health]:
        """The entry of the setup check."""
        return [setup_health(self._running.result)]

    def _evaluate(self) -> None:
        if self._node.active:
            self._background.start()


def setup_health(result: Result) -> Health:
    """Plausible, or the causes with their remedies, or mistakes that are certain but one of several."""
    values = {c.cause: f"{c.evidence}. {c.remedy}" for c in result.causes}
    values |= {f"not decided: {one.what}": one.needed for one in result.undetermined}
    if result.is_plausible:
        return Health(OK, "no setup mistake found", values, PART)
    if not result.causes:
        return Health(WARN, result.headline, values, PART)
    first, *others = result.causes
    words = [f"{first.cause} ({first.source}): {first.evidence}. {first.remedy}"]
    words += [f"also {c.cause} ({c.source}): {c.evidence}" for c in others[: _MOST_CAUSES - 1]]
    return Health(WARN, "; ".join(words), values, PART)
