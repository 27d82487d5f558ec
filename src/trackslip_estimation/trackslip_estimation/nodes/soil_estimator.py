# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``soil_estimator``: track forces and soil parameters, from machine states and hydraulics."""

import math
import sys
import time
from collections import Counter
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.health import ERROR, OK, WARN, Health
from trackslip_common.nodes.messages import make, topic_class
from trackslip_common.nodes.run import run
from trackslip_common.tally import Tally
from trackslip_common.topics import MACHINE_STATE
from trackslip_estimation.soil import conversions
from trackslip_estimation.soil.pressure_watch import PressureFault
from trackslip_estimation.soil.records import HYDRAULICS, Rejection, SoilInput
from trackslip_estimation.soil.soil_estimator import SoilEstimator
from trackslip_estimation.soil.soil_parameters import DEFAULT_FILES, NODE, PARAMETERS, SoilEstimatorParameters

_SILENCE_TIMEOUT = 1.0  # s of silence
NO_OUTPUT_TEXT = "no forces and no soil are estimated"
OTHER_STAMPS_TEXT = (
    f"at other stamps than {MACHINE_STATE}, or further apart than moments.longest_gap (clocks and rates)"
)
_CHECK_TRANSDUCER = "check the transducer, its cable, and its signal in the DBC"
_CHECK_SIGNS = "check factor and unit of the pressures in the DBC, and their sign in the roles file"
_REMEDIES = {
    PressureFault.DROPPED: "check the source of the pressures in /diagnostics",
    PressureFault.LEFT_STUCK: _CHECK_TRANSDUCER,
    PressureFault.RIGHT_STUCK: _CHECK_TRANSDUCER,
    PressureFault.BEYOND_RELIEF: "check the pressures in the DBC, and the relief pressure of the vehicle",
    PressureFault.SWAPPED: "exchange the two pressures in the roles file",
}  # of all others: ``_CHECK_SIGNS``
_REJECTIONS = frozenset(rejection.value for rejection in Rejection)
_NICENESS = 5  # soils change slowly; odometry has priority


def soil_health(
    estimator: SoilEstimator,
    silence_s: float | None,
    counts: Mapping[str, Any],
    unused: Mapping[str, str] = MappingProxyType({}),
) -> Health:
    """Return the entry.

    ``silence_s``: since the last machine state, None before the first one; ``unused``: source → why its
    messages, which arrive, are not used.
    """
    values = {**counts, "restarts": estimator.restarts, **_soil_texts(estimator)}
    if silence_s is None:
        return Health(WARN, "waiting for machine_state", values)
    if silence_s > _SILENCE_TIMEOUT:
        return Health(ERROR, f"slip estimator silent for {silence_s:.1f} s", values)
    if MACHINE_STATE in unused:
        return Health(ERROR, f"{MACHINE_STATE} {unused[MACHINE_STATE]}: {NO_OUTPUT_TEXT}", values)
    if estimator.faults:
        texts = {fault: fault.value for fault in estimator.faults}
        if PressureFault.DROPPED in texts and HYDRAULICS in unused:
            texts[PressureFault.DROPPED] = f"{HYDRAULICS} {unused[HYDRAULICS]}"
        remedies = dict.fromkeys(_REMEDIES.get(fault, _CHECK_SIGNS) for fault in texts)
        text = f"{', '.join(texts.values())}: the estimates are held; {', '.join(remedies)}"
        return Health(ERROR, text, values)
    if any(estimator.stalled):
        text = f"stalled: {_side_names(estimator.stalled)} commanded and under pressure, but not turning"
        return Health(WARN, text, values)
    if any(estimator.stuck):
        return Health(WARN, f"getting stuck: {_side_names(estimator.stuck)} at the limit of the soil", values)
    return Health(OK, "running", values)


def _side_names(flags: tuple[bool, bool]) -> str:
    """Return the names of the sides whose flag is set."""
    return " and ".join(side for side, flag in zip(("left", "right"), flags, strict=True) if flag)


def _soil_texts(estimator: SoilEstimator) -> dict[str, Any]:
    """Return K, F_max, their identifiability and η_V of the flow check, as texts."""
    strength = estimator.strength
    (k_low, k_high), (f_low, f_high) = strength.shear_modulus_interval, strength.thrust_limit_interval
    efficiency = estimator.volumetric_efficiency
    return {
        "shear modulus (cm)": f"{100 * strength.shear_modulus:.2f} ({100 * k_low:.2f} to {100 * k_high:.2f})",
        "tractive effort (N)": f"{strength.thrust_limit:.0f} ({f_low:.0f} to {f_high:.0f})",
        "identifiable": strength.reason or "yes",
        "volumetric efficiency": "unknown" if efficiency is None else f"{efficiency:.3f}",
    }


class SoilEstimatorNode(TrackslipNode[SoilEstimatorParameters]):
    """Converts messages, calls the estimator, publishes; all else is in ``SoilEstimator``."""

    parameters_topic = PARAMETERS

    def __init__(self) -> None:
        super().__init__(NODE, SoilEstimatorParameters, *DEFAULT_FILES)

    def configure(self) -> None:
        """Create the estimator, its outputs and its inputs."""
        self._estimator = (
            None if self.settings.vehicle.missing_groups_message else SoilEstimator(self.settings)
        )
        self._inputs = self._published = 0
        self._received_s: dict[str, float] = {}  # source → steady time of its last message
        self._published_s = 0.0  # steady
        self._rejections: Counter[tuple[str, str]] = Counter()
        self._rejected: dict[str, tuple[str, float]] = {}  # source → latest reason, and its steady time
        self._reported: Any = None
        outputs = (conversions.FORCES, conversions.SOIL, conversions.SEED)
        self._outputs = {topic: self.advertise(topic_class(topic), topic) for topic in outputs}
        if self._estimator is None:
            self.get_logger().warning(f"{self.settings.vehicle.missing_groups_message}: {NO_OUTPUT_TEXT}")
            return
        self.subscribe_packed(topic_class(HYDRAULICS), HYDRAULICS, self._on_hydraulics)
        self.subscribe_packed(topic_class(MACHINE_STATE), MACHINE_STATE, self._on_machine_state)

    def reload(self, values: dict[str, Any]) -> None:
        """Pass the new values to the estimator."""
        if self._estimator is not None:
            self._estimator.set_parameters(self.settings)

    def health(self) -> list[Health]:
        """Return waiting, running, or what is wrong, with unused inputs by source and reason."""
        if self._estimator is None:
            return [Health(WARN, f"{self.settings.vehicle.missing_groups_message}: {NO_OUTPUT_TEXT}")]
        tally, now_s = self._estimator.tally, time.monotonic()
        counts = {"inputs": self._inputs, "messages": self._published, **tally.values()}
        received_s = self._received_s.get(MACHINE_STATE)
        silence_s = None if received_s is None else now_s - received_s
        return [soil_health(self._estimator, silence_s, counts, self._unused(tally, now_s))]

    def _unused(self, tally: Tally, now_s: float) -> dict[str, str]:
        """Return source → why its messages, which arrive, are not used."""
        new, self._rejections = tally.total - self._rejections, tally.total
        self._rejected |= {source: (text, now_s) for source, text in new if text in _REJECTIONS}
        unused = {
            source: f"rejected ({text})"
            for source, (text, rejected_s) in self._rejected.items()
            if now_s - rejected_s <= _SILENCE_TIMEOUT
        }
        if now_s - self._received_s.get(HYDRAULICS, -math.inf) <= _SILENCE_TIMEOUT:
            unused.setdefault(HYDRAULICS, OTHER_STAMPS_TEXT)
        if now_s - self._published_s <= _SILENCE_TIMEOUT:
            unused.pop(MACHINE_STATE, None)
        return unused

    def _on_hydraulics(self, message: Any) -> None:
        self._process(conversions.hydraulics(message))

    def _on_machine_state(self, message: Any) -> None:
        self._process(conversions.machine_state(message))

    def _process(self, soil_input: SoilInput) -> None:
        assert self._estimator is not None
        self._inputs += 1
        self._received_s[soil_input.source] = time.monotonic()
        outputs = self._estimator.advance(soil_input)
        for output in outputs:
            publisher = self._outputs[conversions.topic_of(output)]
            publisher.publish(conversions.message_of(make, output, self.settings.frame))
            self._published += 1
        if outputs:
            self._published_s = time.monotonic()
            self._report_changes(self._estimator)

    def _report_changes(self, estimator: SoilEstimator) -> None:
        """Publish the health at once if faults, stalled or stuck tracks have changed."""
        condition = (estimator.faults, estimator.stalled, estimator.stuck)
        if condition != self._reported:
            self._reported = condition
            self.publish_health()


def main() -> None:
    """Entry point."""
    sys.exit(run(SoilEstimatorNode, niceness=_NICENESS))
