# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The tune file: which parameters are tuned, their bounds, and the objective.

objective: likelihood          # of the innovations; pose: of a reference's poses; position: its mean error
evaluations: 500               # sets of parameters that one search may try
seed: 0
parameters:                    # of slip_estimator, dotted names; sources.*.NAME: of each source that has it
  turning.turning_velocity_error: {low: 0.01, high: 1.0, scale: log}
"""

import fnmatch
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.config_files import read_yaml
from trackslip_common.errors import InputError, suggestion
from trackslip_common.parameter_spec import Spec
from trackslip_common.parameters import Parameters, flat_fields, from_flat, parameter, to_flat
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.sources import KINDS

LIKELIHOOD, POSE, POSITION = "likelihood", "pose", "position"
_AT_READING = "sources.*.stddev"  # applied when a bag is read


@dataclass(frozen=True, kw_only=True)
class Bounds(Parameters):
    """Bounds of a parameter in the search."""

    low: float = parameter("smallest value to try")
    high: float = parameter("largest value to try")
    scale: str = parameter("whether equal steps are equal differences or ratios", choices=("linear", "log"))

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.low < self.high:
            raise InputError(f"low: {self.low:g} is out of range; accepted: < {self.high:g}, which is high")
        if self.scale == "log" and self.low <= 0.0:
            raise InputError(f"low: {self.low:g} is out of range; accepted: > 0 with scale: log")

    def value(self, share: float) -> float:
        """The value at a share of the range from low to high."""
        if self.scale == "log":
            ratio: float = (self.high / self.low) ** share
            return min(max(self.low * ratio, self.low), self.high)
        return self.low + (self.high - self.low) * share

    def share(self, value: float) -> float:
        """The share of the range at which a value lies, 0 … 1; values outside are clipped."""
        clipped = min(max(value, self.low), self.high)
        if self.scale == "log":
            return math.log(clipped / self.low) / math.log(self.high / self.low)
        return (clipped - self.low) / (self.high - self.low)


@dataclass(frozen=True, kw_only=True)
class SearchSettings(Parameters):
    """Objective and budget of a search."""

    objective: str = parameter("objective of the search", choices=(LIKELIHOOD, POSE, POSITION))
    evaluations: int = parameter("largest number of parameter sets in one search", ge=20, le=1_000_000)
    seed: int = parameter("seed of the search", ge=0)


@dataclass(frozen=True)
class Plan:
    """A tune file."""

    settings: SearchSettings
    bounds: dict[str, Bounds]  # by dotted name

    def values(self, shares: FloatArray) -> dict[str, float]:
        """Dotted name → value, at a point (d,) of the unit cube."""
        return {
            name: bounds.value(float(share))
            for (name, bounds), share in zip(self.bounds.items(), shares, strict=True)
        }

    def shares(self, p: SlipEstimatorParameters) -> FloatArray:
        """(d,) the point of the present values; of several sources, the first one's."""
        return np.array([bounds.share(value_of(p, name)) for name, bounds in self.bounds.items()])


def read_plan(path: Path) -> Plan:
    """Read a tune file.

    Raises:
        InputError: the file cannot be read, a name is no number of slip_estimator, or a value is rejected.
    """
    tree = read_yaml(path)
    entries = tree.pop("parameters", None)
    if not isinstance(entries, Mapping) or not entries:
        raise InputError(
            f"{path}: parameters: nothing to tune; accepted: name: {{low: …, high: …, scale: log}}"
        )
    return Plan(
        from_flat(SearchSettings, tree, str(path)),
        {str(name): _parse_bounds(f"{path}: {name}", str(name), entry) for name, entry in entries.items()},
    )


def value_of(p: SlipEstimatorParameters, name: str) -> float:
    """The value of a parameter by its dotted name; of several sources, the first one's.

    Raises:
        InputError: there is no such source.
    """
    value: float = to_flat(p)[matching_names(p, name)[0]]
    return value


def matching_names(p: SlipEstimatorParameters, name: str) -> list[str]:
    """The parameters that match a name of a tune file.

    Raises:
        InputError: no parameter matches.
    """
    names = fnmatch.filter((n for n, kind, _ in flat_fields(p) if kind is float), name)
    if not names:
        accepted = ", ".join(f"sources.{group}" for group in p.sources) or "none, there are no sources"
        raise InputError(f"{name}: no such source to tune; accepted: {accepted}")
    return names


def change_parameters(p: SlipEstimatorParameters, values: Mapping[str, float]) -> SlipEstimatorParameters:
    """Parameters with some values replaced.

    Raises:
        InputError: a value is rejected, or there is no such source.
    """
    return p.changed({full: value for name, value in values.items() for full in matching_names(p, name)})


def _tunable_parameters() -> dict[str, Spec]:
    """Dotted names of parameters that can be tuned; ``*`` stands for any source."""
    fields = [*flat_fields(SlipEstimatorParameters)]
    fields += [
        ("sources.*." + name, kind, spec) for k in KINDS.values() for name, kind, spec in flat_fields(k)
    ]
    return {name: spec for name, kind, spec in fields if kind is float and name != _AT_READING}


def _parse_bounds(where: str, name: str, entry: object) -> Bounds:
    tunable, pattern = _tunable_parameters(), re.sub(r"^sources\.[^.]+\.", "sources.*.", name)
    if pattern not in tunable:
        raise InputError(f"{where}: not to be tuned{suggestion(pattern, tunable)}")
    if not isinstance(entry, Mapping):
        raise InputError(f"{where}: {entry!r} gives no bounds; accepted: {{low: …, high: …, scale: log}}")
    bounds = from_flat(Bounds, {"scale": "linear", **entry}, where)
    for end in (bounds.low, bounds.high):
        if not tunable[pattern].accepts(end):
            raise InputError(
                f"{where}: {end:g} is out of range; accepted: {tunable[pattern].accepted_range()}"
            )
    return bounds
