# SPDX-License-Identifier: Apache-2.0
"""What the drivers share: one link to a sensor, and its health."""

import time
from typing import Any, TypeVar

from trackslip_common.nodes.base import ERROR, OK, STALE, WARN, Health, TrackslipNode
from trackslip_common.parameters import Parameters
from trackslip_drivers.transports.link import Link

P = TypeVar("P", bound=Parameters)

_STALE_PERIODS = 10


class DriverNode(TrackslipNode[P]):
    """Opens its link while active; says at 1 Hz whether data come, how fast, and what was rejected."""

    period = 1.0  # s between messages when all is well

    def configure(self) -> None:
        """Start counting."""
        self._published = 0
        self._looked_at = (time.monotonic(), 0)
        self._last_s = -float("inf")
        self._link: Link[Any] | None = None

    def make_link(self) -> Link[Any]:
        """A fresh link to the sensor; it is started by ``activate``."""
        raise NotImplementedError

    def activate(self) -> None:
        """Open the link."""
        self._link = self.make_link()
        self._link.start()

    def deactivate(self) -> None:
        """Close the link."""
        if self._link is not None:
            self._link.stop()

    def count(self) -> None:
        """One more message published."""
        self._published += 1
        self._last_s = time.monotonic()

    def health(self) -> list[Health]:
        """Connection, rate, age, rejections."""
        if self._link is None or not self.active:
            return [Health(OK, "inactive")]
        state, now_s = self._link.state(), time.monotonic()
        then_s, then = self._looked_at
        self._looked_at = (now_s, self._published)
        age_s = now_s - self._last_s
        values: dict[str, Any] = {
            "published": self._published,
            "rate (Hz)": f"{(self._published - then) / max(now_s - then_s, 1e-3):.1f}",
            "age (s)": f"{age_s:.2f}",
            "reconnects": max(state.openings - 1, 0),
            "errors": state.errors,
            "last error": state.last_error,
            "note": state.note,
        }
        values |= {f"{source}: {reason}": n for (source, reason), n in sorted(self.tally.total.items())}
        news = self.tally.since_last_look()
        if not state.connected:
            return [Health(ERROR, f"not connected: {state.last_error or 'opening'}", values)]
        if age_s > _STALE_PERIODS * self.period:
            return [Health(STALE, "connected, but no data", values)]
        if news:
            return [Health(WARN, f"{sum(news.values())} rejected in the last second", values)]
        return [Health(OK, "running", values)]
