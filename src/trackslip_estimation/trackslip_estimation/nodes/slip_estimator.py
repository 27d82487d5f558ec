# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``slip_estimator``: odometry, slips and a report on each input, from sprockets, yaw rates and poses."""

import sys
from typing import Any

from std_srvs.srv import SetBool, Trigger

from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.health import Health
from trackslip_common.nodes.messages import make, topic_class
from trackslip_common.nodes.outputs import PackedOutput
from trackslip_common.nodes.run import run
from trackslip_common.vehicle_files import TOPIC as VEHICLE
from trackslip_common.vehicle_files import vehicle_text
from trackslip_estimation.nodes.estimate_outputs import EstimateOutputs
from trackslip_estimation.nodes.estimator_health import estimator_health
from trackslip_estimation.nodes.measurement_sources import MeasurementSources
from trackslip_estimation.nodes.setup_monitor import SetupMonitor
from trackslip_estimation.nodes.state_keeper import StateKeeper
from trackslip_estimation.slip import conversions
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import (
    FORGET,
    FREEZE,
    RELOAD,
    RESET,
    UNFREEZE,
    Command,
    Input,
    Outcome,
    Reload,
    Report,
)
from trackslip_estimation.slip.parameters import DEFAULT_FILES, NODE, SlipEstimatorParameters
from trackslip_estimation.slip.source_watch import SourceWatch
from trackslip_estimation.slip.sources import Rejection


class SlipEstimatorNode(TrackslipNode[SlipEstimatorParameters]):
    """Connects sources, estimator and outputs; all else is in ``SlipEstimator``."""

    realtime_priority = 10  # controllers use the odometry
    parameters_topic = RELOAD

    def __init__(self) -> None:
        super().__init__(NODE, SlipEstimatorParameters, *DEFAULT_FILES)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(Trigger, "~/forget", self._on_forget)
        self.create_service(SetBool, "~/freeze", self._on_freeze)

    def configure(self) -> None:
        """Create the estimator, its outputs and its inputs."""
        p = self.settings
        self._state_keeper = StateKeeper(self, lambda: self._estimator)
        self._estimator = SlipEstimator(p, learned=self._state_keeper.learned)
        self._watch = SourceWatch(p.timeouts_ns())
        self._setup = SetupMonitor(self, lambda error: self.callback_failures.add("setup check", error))
        self._processed = self._estimates = 0
        self._vehicle = self.advertise(topic_class(VEHICLE), VEHICLE)
        self._reporter = self.advertise(topic_class("measurement_reports"), "measurement_reports")
        self._reports: dict[str, PackedOutput] = {}  # by source, whose name is a string of the message
        self._outputs = EstimateOutputs(self)
        self._sources = MeasurementSources(self, self._process, self._reject)

    def activate(self) -> None:
        """Publish the parameters of the vehicle."""
        self._vehicle.publish(make("std_msgs/msg/String", data=vehicle_text(self.settings.vehicle)))

    def reload(self, values: dict[str, Any]) -> None:
        """Create the estimator again before its first run; later, pass the new values to it."""
        if self.has_run:
            self._process(Reload(values))
        else:
            self._estimator = SlipEstimator(self.settings, learned=self._state_keeper.learned)
        self._watch.set_timeouts(self.settings.timeouts_ns())

    def start_inputs(self) -> dict[str, Any]:
        """Return the states learned before this run, for the bag."""
        return self._state_keeper.start_inputs()

    def deactivate(self) -> None:
        """Save the learned states."""
        self._state_keeper.finish()
        self._setup.finish()

    def health(self) -> list[Health]:
        """Return the entries of estimator, setup check and state file, with counts of rejected inputs."""
        counts = {"measurements": self._processed, "estimates": self._estimates, **self.tally.values()}
        sources = self._sources
        return [
            estimator_health(
                self._estimator, self._watch, sources.sprocket_silence_s, counts, sources.sprocket_fault
            ),
            *self._setup.health(),
            *self._state_keeper.health(),
        ]

    def _on_reset(self, _: Any, response: Any) -> Any:
        return self._apply_command(
            Command(RESET), response, "the estimate was reset; learned values are kept"
        )

    def _on_forget(self, _: Any, response: Any) -> Any:
        if self.active:
            self._state_keeper.forget()
        return self._apply_command(Command(FORGET), response, "the estimate was reset without learned values")

    def _on_freeze(self, request: Any, response: Any) -> Any:
        text = "poses are ignored from now on" if request.data else "poses are used again"
        return self._apply_command(Command(FREEZE if request.data else UNFREEZE), response, text)

    def _apply_command(self, command: Command, response: Any, text: str) -> Any:
        if self.active:
            self._process(command)
            self._watch.clear()
        response.success, response.message = self.active, text if self.active else "the node is not active"
        return response

    def _process(self, estimator_input: Input) -> Report:
        report, estimate = self._estimator.process(estimator_input)
        if estimate is not None:  # first: controllers use it
            self._outputs.publish(estimate)
            self._estimates += 1
        self._publish_report(report)
        self._processed += 1
        self._setup.add_input(estimator_input)
        self._watch.add(report)
        if report.outcome is not Outcome.ACCEPTED:
            self.tally.add(report.source, report.outcome)
        for reason in (report.fault, report.attitude):
            if reason is not None:
                self.tally.add(report.source, reason)
        return report

    def _reject(self, source: str, reason: Rejection) -> None:
        """Count a message that never becomes a measurement."""
        self.tally.add(source, reason)
        self._watch.add_rejection(source, reason.value)

    def _publish_report(self, report: Report) -> None:
        if report.source not in self._reports:
            blank = conversions.blank_measurement_report(make, report.source)
            self._reports[report.source] = PackedOutput(self._reporter, blank)
        output = self._reports[report.source]
        conversions.fill_measurement_report(output.message, report, self._processed)
        output.publish()


def main() -> None:
    """Entry point."""
    sys.exit(run(SlipEstimatorNode))
