# SPDX-License-Identifier: Apache-2.0
"""``soil_estimator``: odometry, slips and hydraulics in; forces of the tracks and the soil's strength out."""

import sys
import time
from typing import Any

from rcl_interfaces.msg import SetParametersResult

from trackslip_common.config_files import parameters_text
from trackslip_common.errors import InputError
from trackslip_common.nodes.base import Health, TrackslipNode
from trackslip_common.nodes.messages import make, topic_class
from trackslip_common.nodes.run import run
from trackslip_common.parameters import to_flat
from trackslip_estimation.nodes.soil_health import soil_health
from trackslip_estimation.soil import conversions
from trackslip_estimation.soil.records import HYDRAULICS, ODOMETRY, SLIPS, SoilInput
from trackslip_estimation.soil.soil_estimator import SoilEstimator
from trackslip_estimation.soil.soil_parameters import (
    DEFAULT_FILES,
    NODE,
    PARAMETERS,
    SoilEstimatorParameters,
    reloadable,
)

_NICENESS = 5  # soils change slowly; the odometry that it listens to is waited for by others


class SoilEstimatorNode(TrackslipNode[SoilEstimatorParameters]):
    """Converts, calls the estimator, publishes; all else is in ``SoilEstimator``."""

    def __init__(self) -> None:
        super().__init__(NODE, SoilEstimatorParameters, *DEFAULT_FILES)
        self.add_on_set_parameters_callback(self._on_parameters)

    def configure(self) -> None:
        """Make the estimator, its outputs and its inputs."""
        self._estimator = SoilEstimator(self.settings)
        self._inputs = self._published = 0
        self._heard: float | None = None  # s, steady: when the slip estimator was last heard
        outputs = (conversions.FORCES, conversions.SOIL, conversions.SEED)
        self._outputs = {topic: self.announce(topic_class(topic), topic) for topic in outputs}
        self._parameters_used = self.announce(topic_class(PARAMETERS), PARAMETERS)
        self.listen(topic_class(HYDRAULICS), HYDRAULICS, self._on_hydraulics)
        self.listen(topic_class(ODOMETRY), ODOMETRY, self._on_odometry)
        self.listen(topic_class(SLIPS), SLIPS, self._on_slips)

    def activate(self) -> None:
        """Publish the parameters with which the estimates of this run are made: a bag carries them along."""
        text = parameters_text(to_flat(self.settings), NODE)
        self._parameters_used.publish(make("std_msgs/msg/String", data=text))

    def health(self) -> list[Health]:
        """Waiting, running, or what is wrong; what was not used, by source and reason."""
        total = self._estimator.tally.total
        rejected = {f"{source}: {reason}": n for (source, reason), n in sorted(total.items())}
        counts = {"inputs": self._inputs, "messages": self._published, **rejected}
        silent = None if self._heard is None else time.monotonic() - self._heard
        return [soil_health(self._estimator, silent, counts)]

    def _on_hydraulics(self, message: Any) -> None:
        self._process(conversions.hydraulics(message))

    def _on_odometry(self, message: Any) -> None:
        self._heard = time.monotonic()
        self._process(conversions.odometry(message))

    def _on_slips(self, message: Any) -> None:
        self._process(conversions.slips(message))

    def _process(self, given: SoilInput) -> None:
        self._inputs += 1
        for output in self._estimator.advance(given):
            publisher = self._outputs[conversions.topic_of(output)]
            publisher.publish(conversions.message_of(make, output, self.settings.base_frame))
            self._published += 1

    def _on_parameters(self, parameters: list[Any]) -> SetParametersResult:
        """Those that may change while it runs; ROS itself refuses the others."""
        values = {p.name: p.value for p in parameters if p.name in reloadable()}
        try:
            self.settings = self.settings.changed(values)
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        if self.active:
            self._estimator.use(self.settings)
        return SetParametersResult(successful=True)


def main() -> None:
    """Entry point."""
    sys.exit(run(SoilEstimatorNode, niceness=_NICENESS))
