# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Results of a demo run: message counts, and requirements that the run misses."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from trackslip_bags.reader import Bag
from trackslip_common.topics import SENSOR_TOPICS

POSITION_LIMIT = 0.15  # m, RMSE
NEES_LIMIT = 8.0  # of the position: an error of 2 σ in both axes, σ as estimated
RECEIVED_LIMIT = 0.99  # share of the emitted messages


@dataclass(frozen=True)
class Counts:
    """Message counts of one topic."""

    emitted: int
    received: int
    recorded: int

    @property
    def share(self) -> float:
        """Received share of the emitted messages."""
        return self.received / self.emitted if self.emitted else 0.0


def counts_of(bag: Bag, emitted: Mapping[str, int], received: Mapping[str, int]) -> dict[str, Counts]:
    """Counts of the sensor topics with emitted messages."""
    recorded = {topic: info.count for topic, info in bag.topics.items()}
    return {
        topic: Counts(emitted[topic], received.get(topic, 0), recorded.get(f"/{topic}", 0))
        for topic in SENSOR_TOPICS
        if emitted.get(topic)
    }


def shortfalls(summary: Mapping[str, Any], counts: Mapping[str, Counts]) -> list[str]:
    """One line per missed requirement of the demo; ``summary`` is that of ``trackslip replay``."""
    lines = [
        f"{topic}: {100.0 * count.share:.2f} % received, at least {100.0 * RECEIVED_LIMIT:g} % expected"
        for topic, count in counts.items()
        if count.share < RECEIVED_LIMIT
    ]
    if not summary.get("replay_matches"):
        lines.append("the replay's estimates are not the live ones")
    if not (summary.get("soil") or {}).get("replay_matches", True):
        lines.append("the replay's forces and soil are not the live ones")
    position, nees = (
        math.inf if value is None else value
        for value in (summary["rmse"]["filter"], summary["nees_position"])
    )
    if position > POSITION_LIMIT and nees > NEES_LIMIT:
        expected = f"at most {POSITION_LIMIT:g} m or twice the stated deviation expected"
        lines.append(f"position RMSE: {position:.3f} m, {expected}")
    return lines
