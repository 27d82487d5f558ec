# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What a demo run came to: the live estimates and soil against the truth, counts, and replay against live."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path as File
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.parameters import bag_parameters
from trackslip_bags.reader import Bag
from trackslip_common.topics import (
    FORCES,
    ODOMETRY,
    SOIL,
    TRACK_SLIP,
    TRUE_FORCES,
    TRUE_ODOMETRY,
    TRUE_SLIP,
    TRUE_SOIL,
)
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.soil.soil_parameters import NODE as SOIL_NODE
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_sim.demo.graph import SENSOR_TOPICS
from trackslip_tools.replay.comparison import LiveComparison
from trackslip_tools.replay.dead_reckoning import Path
from trackslip_tools.replay.parts import Part, Watch, together
from trackslip_tools.replay.run import replay
from trackslip_tools.replay.scoring import Score, moving_slips, path_of_series, score, slip_rmse
from trackslip_tools.replay.series import Series, SeriesCollector
from trackslip_tools.replay.soil import SoilComparison, SoilReplay

FloatArray = NDArray[np.float64]

MODULUS, LIMIT = "shear_modulus", "max_tractive_effort"  # their 5 and 95 % points: _lower, _upper
POSITION_LIMIT = 0.15  # m
_STATED = 2.0  # σ: without fixes an estimate is as good as it states
RECEIVED_LIMIT = 0.99  # of what was emitted
_LIVE = frozenset((ODOMETRY, TRACK_SLIP))


class Finding(NamedTuple):
    """One number at the end of the drive."""

    name: str
    found: float
    interval: tuple[float, float]  # 5 % and 95 % points
    true: float


@dataclass(frozen=True, eq=False)
class SoilResult:
    """What the table and the picture show."""

    forces: Series
    true_forces: Series
    soil: Series
    true_soil: Series
    thrust_rmse: float  # N
    live: SoilComparison
    likely: tuple[str, float]  # the most probable class

    @property
    def findings(self) -> list[Finding]:
        """μ_r, K and F_max at the end; the mobilised μ_l is in the picture."""
        last, true = self.soil.rows[-1], self.true_soil.rows[-1]
        spread = 1.645 * float(np.sqrt(last["mu_r_variance"]))
        mu_r = float(last["mu_r"])
        found = [Finding("μ_r", mu_r, (mu_r - spread, mu_r + spread), float(true["mu_r"]))]
        for name, field in (("K, m", MODULUS), ("F_max, N", LIMIT)):
            value, low, high = (float(last[f"{field}{end}"]) for end in ("", "_lower", "_upper"))
            found.append(Finding(name, value, (low, high), float(true[field])))
        return found

    def numbers(self) -> dict[str, Any]:
        """For the summary."""
        mu_r, modulus, limit = self.findings
        return {
            "thrust_rmse": self.thrust_rmse,
            "mu_r": mu_r.found,
            "K": modulus.found,
            "K_interval": modulus.interval,
            "F_max": limit.found,
            "F_max_interval": limit.interval,
            "identifiable": bool(self.soil["identifiable"][-1]),
            "class": self.likely[0],
            "replay_matches": self.live.matches,
        }


def soil_result(replayed: SoilReplay, from_ns: int) -> SoilResult | None:
    """From ``from_ns`` on; None where the bag lacks live or true forces or soil."""
    series = {name: rows.since(from_ns) for name, rows in replayed.series.items()}
    names = (FORCES, TRUE_FORCES, SOIL, TRUE_SOIL)
    if replayed.live is None or any(not len(series[name].stamps_ns) for name in names if name in series):
        return None
    if not all(name in series for name in names):
        return None
    forces, true_forces, soil, true_soil = (series[name] for name in names)
    classes = replayed.states[-1].classes
    likely = max(classes, key=lambda name: classes[name])
    return SoilResult(
        forces,
        true_forces,
        soil,
        true_soil,
        _rmse(forces, true_forces),
        replayed.live,
        (likely, classes[likely]),
    )


def _rmse(found: Series, true: Series) -> float:
    """Of both thrusts, at the stamps of what was found."""
    errors = [
        found[thrust] - np.interp(found.stamps_ns, true.stamps_ns, true[thrust])
        for thrust in ("left_thrust", "right_thrust")
    ]
    return float(np.sqrt(np.mean(np.square(errors))))


@dataclass(frozen=True)
class Counts:
    """Messages of one topic on their way."""

    emitted: int
    received: int
    recorded: int

    @property
    def share(self) -> float:
        """Received of emitted."""
        return self.received / self.emitted if self.emitted else 0.0


@dataclass(frozen=True, eq=False)
class DemoResult:
    """Everything that the table, the picture and the JSON file show."""

    vehicle: str  # its name
    filter: Score
    dead_reckoning: Score
    slip_rmse: float
    dead_reckoning_slip_rmse: float  # dead reckoning takes the slips to be zero
    topics: dict[str, Counts]
    live: LiveComparison
    truth: Path
    paths: dict[str, Path]
    odometry: Series
    slips: Series
    true_slips: Series
    soil: SoilResult | None
    of_bag: Score | None  # over the whole bag, as ``trackslip replay`` scores it
    before_s: float  # s of standing in the bag before the drive

    @property
    def position_limit(self) -> float:
        """m, RMSE; more of a drive out of the laser's sight, where no more is stated."""
        of_position = self.odometry["covariance"][:, :2, :2]
        stated = np.sqrt(np.trace(of_position, axis1=1, axis2=2).mean())
        return max(POSITION_LIMIT, _STATED * float(stated))

    @property
    def misses(self) -> list[str]:
        """What the demo is there to show, and does not."""
        lines = [
            f"{topic}: {100.0 * counts.share:.2f} % received, at least {100.0 * RECEIVED_LIMIT:g} % expected"
            for topic, counts in self.topics.items()
            if counts.share < RECEIVED_LIMIT
        ]
        if not self.live.matches:
            lines.append("the replay's estimates are not the live ones")
        if self.soil is not None and not self.soil.live.matches:
            lines.append("the replay's forces and soil are not the live ones")
        if self.filter.position > self.position_limit:
            found = f"{self.filter.position:.3f} m, at most {self.position_limit:.3g} m expected"
            lines.append(f"position RMSE over the drive: {found}")
        return lines

    def save(self, file: File) -> None:
        """Write the numbers as JSON."""
        numbers = {
            "vehicle": self.vehicle,
            "position_rmse": self.filter.position,
            "dead_reckoning_rmse": self.dead_reckoning.position,
            "heading_rmse": self.filter.heading,
            "slip_rmse": self.slip_rmse,
            "topics": {topic: vars(counts) for topic, counts in self.topics.items()},
            "replay_matches": self.live.matches,
        }
        if self.soil is not None:
            numbers["soil"] = self.soil.numbers()
        file.write_text(json.dumps(numbers, indent=2) + "\n", encoding="utf-8")


def evaluate(
    bag: Bag,
    emitted: Mapping[str, int],
    received: Mapping[str, int],
    drive_start_ns: int,
    watch: Watch = lambda _: None,
) -> DemoResult | None:
    """Replay the bag and score its live estimates over the drive; None where it holds no estimates."""
    p = load_slip_parameters(bag_parameters(bag))
    of_soil = load_soil_parameters(bag_parameters(bag, SOIL_NODE))
    collector = SeriesCollector(_LIVE)

    def collect(part: Part) -> None:
        for topic in _LIVE & part.tables.keys():
            collector.add(topic, part.tables[topic].rows)

    result = replay(bag, p, InputFilters(), TRUE_ODOMETRY, of_soil, together(watch, collect))
    series = result.series | collector.series()
    if result.live is None or any(name not in series for name in (TRUE_ODOMETRY, TRUE_SLIP, TRACK_SLIP)):
        return None
    driven = {name: each.since(drive_start_ns) for name, each in series.items()}
    odometry, slips, true_slips = (driven[name] for name in (ODOMETRY, TRACK_SLIP, TRUE_SLIP))
    if not (len(odometry) and len(slips)):
        return None
    truth, live = path_of_series(driven[TRUE_ODOMETRY]), path_of_series(odometry)
    encoders = result.paths["dead_reckoning"]
    of_filter, of_encoders = score(live, truth), score(encoders, truth)
    moving = moving_slips(series[TRUE_ODOMETRY], true_slips, p.vehicle.kinematics.tread)
    slip_error = slip_rmse(slips, moving)
    if of_filter is None or of_encoders is None or slip_error is None:
        return None
    return DemoResult(
        p.vehicle.name,
        of_filter,
        of_encoders,
        slip_error,
        float(np.sqrt(np.nanmean(moving.columns("left_slip", "right_slip") ** 2))),
        _counts(bag, emitted, received),
        result.live,
        truth,
        {"dead_reckoning": encoders, "filter": live},
        odometry,
        slips,
        true_slips,
        None if result.soil is None else soil_result(result.soil, drive_start_ns),
        result.scores.get("filter"),
        (drive_start_ns - bag.start_ns) * 1e-9,
    )


def _counts(bag: Bag, emitted: Mapping[str, int], received: Mapping[str, int]) -> dict[str, Counts]:
    """Of the sensors that have sent anything."""
    recorded = {topic: info.count for topic, info in bag.topics.items()}
    return {
        topic: Counts(emitted[topic], received.get(topic, 0), recorded.get(f"/{topic}", 0))
        for topic in SENSOR_TOPICS
        if emitted.get(topic)
    }
