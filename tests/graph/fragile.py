# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A node whose callbacks fail while its parameter ``fails`` is true; run as a program."""

import sys
from dataclasses import dataclass
from typing import Any

from std_srvs.srv import Trigger

from trackslip_common.nodes import failures
from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.health import OK, Health
from trackslip_common.nodes.messages import topic_class
from trackslip_common.nodes.run import run
from trackslip_common.parameters import Parameters, parameter


@dataclass(frozen=True, kw_only=True)
class FragileParameters(Parameters):
    """When and for how long callbacks fail."""

    fails: bool = parameter("whether callbacks raise", read_only=False)
    duration: float = parameter("duration of failures that ends the node", unit="s", gt=0.0)


class Fragile(TrackslipNode[FragileParameters]):
    """Counts scans and records the parameters passed to its core."""

    def __init__(self) -> None:
        super().__init__("fragile", FragileParameters)
        failures.STREAK_S = self.settings.duration

    def configure(self) -> None:
        """Create one callback of each kind."""
        self.scans = 0
        self.reloads: list[dict[str, Any]] = []
        self.fails = self.settings.fails
        self.subscribe(topic_class("scan"), "scan", self._on_scan)
        self.create_timer(0.05, self._on_timer)
        self.create_service(Trigger, "~/reset", self._on_reset)

    def reload(self, values: dict[str, Any]) -> None:
        """Record new parameters; the node itself is the core."""
        self.fails = values["fails"]
        self.reloads.append(values)

    def health(self) -> list[Health]:
        """Counts of scans and reloads."""
        self._fail()
        return [Health(OK, "running", {"scans": self.scans, "reloads": self.reloads})]

    def _on_scan(self, _: Any) -> None:
        self._fail()
        self.scans += 1

    def _on_timer(self) -> None:
        self._fail()

    def _on_reset(self, _: Any, response: Any) -> Any:
        self._fail()
        response.success = True
        return response

    def _fail(self) -> None:
        if self.fails:
            raise RuntimeError("requested by the test")


if __name__ == "__main__":
    sys.exit(run(Fragile))
