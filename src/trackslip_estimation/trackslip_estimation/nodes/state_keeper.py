# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""State file of a node: read when the node is configured, written once a minute and at the end."""

from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock, ClockType

from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.health import OK, WARN, Health
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.learned import learned_context, to_tree
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.state_file import StateFile

_PERIOD = 60.0  # s
_LEAST_CERTAINTY = 0.99  # probability of the most probable branch, below which nothing is written


class StateKeeper:
    """Keeps the states learned by ``estimator()``; does nothing without a state file."""

    def __init__(
        self, node: TrackslipNode[SlipEstimatorParameters], estimator: Callable[[], SlipEstimator]
    ) -> None:
        self._node, self._estimator = node, estimator
        self._learned_context = learned_context(node.settings)
        self._file = StateFile(node.settings.state_file)
        self.learned = self._file.read(self._learned_context)  # before this run
        if self._file:
            log = node.get_logger()
            log.info(self._file.note) if self._file.used else log.warning(self._file.note)
            node.create_timer(_PERIOD, self._save, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def start_inputs(self) -> dict[str, Any]:
        """Return the states learned before this run, as they are stored in a bag."""
        return {} if self.learned is None else {"learned": to_tree(self.learned, self._learned_context)}

    def forget(self) -> None:
        """Delete the file."""
        self._file.forget(self._learned_context)

    def finish(self) -> None:
        """Write the file for the last time."""
        self._write()
        self._file.finish()
        if self._file.failure:
            self._node.get_logger().warning(f"learned values are not saved: {self._file.failure}")

    def health(self) -> list[Health]:
        """Return the entry of /diagnostics; none without a file."""
        if not self._file:
            return []
        level = OK if self._file.used and not self._file.failure else WARN
        message = f"cannot be written: {self._file.failure}" if self._file.failure else self._file.note
        return [Health(level, message, self._file.status(), "state file")]

    def _save(self) -> None:
        if self._node.active:
            self._write()

    def _write(self) -> None:
        estimator = self._estimator()
        if not estimator.started or estimator.certainty >= _LEAST_CERTAINTY:
            self._file.write(estimator.learned, self._learned_context)
