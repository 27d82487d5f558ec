# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Scenarios: commands, ground and sensor faults of a run (``config/scenarios/*.yaml``)."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trackslip_common.arrays import FloatArray, IntArray
from trackslip_common.errors import InputError
from trackslip_common.vehicle_files import DEFAULT_VEHICLE
from trackslip_common.yaml_tree import check_keys, number, text
from trackslip_sim.machine.faults import Fault, read_fault
from trackslip_sim.scenarios.record_files import load_record, read_list, record_names
from trackslip_sim.scenarios.terrains import load_terrain
from trackslip_sim.truth.ground import Patch
from trackslip_sim.truth.terrain import FLAT, Terrain

_OPTIONAL = ("soil", "patches", "terrain", "segments", "relief_pressure", "faults", "vehicle")


@dataclass(frozen=True)
class Segment:
    """Sprocket speeds commanded for a duration; target of the swing and load of the bucket.

    Raises:
        InputError: the duration is not above 0, or the load is negative.
    """

    duration: float  # s
    left: float  # rad/s
    right: float  # rad/s
    swing_to: float | None = None  # rad, angle of the upper structure; None: as before
    load: float | None = None  # kg in the bucket; None: as before

    def __post_init__(self) -> None:
        if not 0.0 < self.duration < math.inf:
            raise InputError(f"segment: duration = {self.duration!r} is refused; accepted: > 0 s")
        if (self.load or 0.0) < 0.0:
            raise InputError(f"segment: load = {self.load!r} is refused; accepted: >= 0 kg")


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """One run: segments in order, from rest at the origin of a terrain, on ``soil`` with patches over it."""

    name: str
    soil: str
    segments: tuple[Segment, ...]
    patches: tuple[Patch, ...] = ()
    terrain: Terrain = FLAT
    relief_pressure: float | None = None  # Pa; None: the vehicle's
    faults: tuple[Fault, ...] = ()  # of the sensors of the emulator
    vehicle: str = DEFAULT_VEHICLE  # default vehicle of the scenario

    def __post_init__(self) -> None:
        if not self.segments:
            raise InputError(f"scenario '{self.name}': segments = [] is refused; accepted: one or more")
        if self.relief_pressure is not None and not 0.0 < self.relief_pressure < math.inf:
            raise InputError(
                f"scenario '{self.name}': relief_pressure = {self.relief_pressure!r} is refused;"
                " accepted: > 0 Pa"
            )

    @property
    def duration(self) -> float:
        """Sum of the segments' durations, s."""
        return sum(segment.duration for segment in self.segments)

    def with_duration(self, duration: float) -> Scenario:
        """The scenario cut, or its segments repeated, to ``duration``, s.

        Raises:
            InputError: the duration is not above 0.
        """
        if not 0.0 < duration < math.inf:
            raise InputError(f"duration: {duration!r} is refused; accepted: > 0 s")
        segments: list[Segment] = []
        remaining = duration
        while remaining > 1e-9:
            for segment in self.segments:
                part = min(segment.duration, remaining)
                segments.append(dataclasses.replace(segment, duration=part))
                remaining -= part
                if remaining <= 1e-9:
                    break
        return dataclasses.replace(self, segments=tuple(segments))

    def steps(self, step: float) -> int:
        """Number of steps of ``step`` s.

        Raises:
            InputError: the scenario is shorter than one step.
        """
        count = round(self.duration / step)
        if count < 1:
            raise InputError(
                f"scenario '{self.name}': {self.duration!r} s is shorter than a step; accepted: >= {step:g} s"
            )
        return count

    def commands(self, step: float, begin: int = 0, end: int | None = None) -> FloatArray:
        """Commanded (left, right) sprocket speeds (n, 2), rad/s, for steps ``begin`` to ``end`` (excluded).

        Raises:
            InputError: the scenario is shorter than one step.
        """
        count = self.steps(step)
        index = self._segment_indices(step, begin, count if end is None else end)
        speeds = np.array([[segment.left, segment.right] for segment in self.segments], dtype=np.float64)
        chosen: FloatArray = speeds[index]
        return chosen

    @property
    def has_swing(self) -> bool:
        """Whether any segment swings the upper structure."""
        return any(segment.swing_to is not None for segment in self.segments)

    def swing_targets(self, step: float, begin: int, end: int) -> FloatArray:
        """(n,) target of the swing angle in each step, rad; initially 0."""
        return self._values_by_step([segment.swing_to for segment in self.segments], step, begin, end)

    @property
    def has_bucket_load(self) -> bool:
        """Whether any segment loads the bucket."""
        return any(segment.load for segment in self.segments)

    def bucket_masses(self, step: float, begin: int, end: int) -> FloatArray:
        """(n,) mass in the bucket in each step, kg; initially 0."""
        return self._values_by_step([segment.load for segment in self.segments], step, begin, end)

    def _values_by_step(
        self, values: Sequence[float | None], step: float, begin: int, end: int
    ) -> FloatArray:
        """(n,) value of each step: that of its segment, or the last one that is not None; initially 0."""
        last_values = [0.0]
        for value in values:
            last_values.append(last_values[-1] if value is None else value)
        by_step: FloatArray = np.array(last_values[1:])[self._segment_indices(step, begin, end)]
        return by_step

    def _segment_indices(self, step: float, begin: int, end: int) -> IntArray:
        """(n,) index of the segment of each step."""
        ends = np.cumsum([segment.duration for segment in self.segments])
        middles = (np.arange(begin, end) + 0.5) * step
        return np.minimum(np.searchsorted(ends, middles), len(ends) - 1)


def scenario_names() -> list[str]:
    """Names of the scenarios in ``config/scenarios``."""
    return record_names("scenario")


def load_scenario(name_or_file: str, terrain: str = "", duration: float = 0.0) -> Scenario:
    """A scenario by its name in ``config/scenarios``, or from a user's file.

    ``terrain`` replaces its own; the scenario is cut or repeated to ``duration``, s (0: unchanged).

    Raises:
        InputError: scenario or terrain is unknown, or its file or the duration is refused.
    """
    scenario = load_record("scenario", name_or_file, scenario_names(), parse_scenario)
    if terrain:
        scenario = dataclasses.replace(scenario, terrain=load_terrain(terrain))
    return scenario.with_duration(duration) if duration else scenario


def parse_scenario(tree: Mapping[str, Any]) -> Scenario:
    """A scenario from the mapping of its file.

    Raises:
        InputError: a key is missing or unknown, or a value is refused.
    """
    check_keys("scenario", tree, ("name",), _OPTIONAL)
    texts = {key: text(key, tree[key]) for key in ("name", "soil", "terrain", "vehicle") if key in tree}
    patches = tuple(read_list(tree, "patches", _read_patch))
    segments = tuple(read_list(tree, "segments", _read_segment))
    relief = number("relief_pressure", tree["relief_pressure"]) if "relief_pressure" in tree else None
    if "soil" not in tree and not patches:
        raise InputError("soil is missing; accepted: a name, or 'patches' with one or more")
    return Scenario(
        name=texts["name"],
        soil=texts.get("soil") or patches[0].soil,
        segments=segments,
        patches=patches,
        terrain=load_terrain(texts.get("terrain", FLAT.name)),
        relief_pressure=relief,
        faults=tuple(read_list(tree, "faults", read_fault)),
        vehicle=texts.get("vehicle", DEFAULT_VEHICLE),
    )


def _read_patch(entry: Mapping[str, Any]) -> Patch:
    edges = ("from_x", "to_x", "from_y", "to_y")
    check_keys("patch", entry, ("soil", *edges), ())
    numbers = {edge: number(f"patch: {edge}", entry[edge]) for edge in edges}
    return Patch(soil=text("patch: soil", entry["soil"]), **numbers)


def _read_segment(entry: Mapping[str, Any]) -> Segment:
    check_keys("segment", entry, ("duration", "left", "right"), ("swing_to", "load"))
    return Segment(**{key: number(f"segment: {key}", value) for key, value in entry.items()})
