# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A first mapping for one CSV log, from the names of its columns; a user reads and corrects it."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from trackslip_bags.importing.csv_text import Dialect, encoding_of, find_head, lines_of
from trackslip_bags.importing.log_kinds import refuse_other_kinds
from trackslip_common.config_files import load_parameters
from trackslip_common.errors import InputError
from trackslip_common.units import UNITS
from trackslip_estimation.gnss.parameters import NODE, GnssLocalizerParameters

_LINES = 200  # in which the names are looked for

# As they stand in names, where / and ° cannot.
_SPELT = {"kmh": "km/h", "kph": "km/h", "mps": "m/s", "m_s": "m/s", "rad_s": "rad/s", "rads": "rad/s"} | {
    "deg_s": "deg/s", "degs": "deg/s", "dps": "deg/s", "sec": "s", "km_h": "km/h"
}  # fmt: skip


class _Kind(NamedTuple):
    """A field of a mapping, and the names that columns of it have."""

    topic: str  # empty: the time
    field: str
    names: str  # a regular expression
    quantities: tuple[str, ...]
    usual: str  # unit where the name has none


def _side(side: str) -> str:
    moving = "(?:speed|vel|velocity|track|wheel|sprocket|v|w|omega)?"
    return f"{moving}_?(?:{side}|{side[0]})_?{moving}"


_KINDS = (
    _Kind("", "time", r"t|time|stamp|timestamp|seconds?|secs?", ("time",), "s"),
    _Kind("sprockets", "left_velocity", _side("left"), ("speed", "angular rate"), "m/s"),
    _Kind("sprockets", "right_velocity", _side("right"), ("speed", "angular rate"), "m/s"),
    _Kind(
        "imu/data_raw",
        "angular_velocity_z",
        r"(?:gyro|g|w|omega|rate|angular_velocity)_?z|yaw_?rate|turn_?rate",
        ("angular rate",),
        "rad/s",
    ),
    _Kind("gnss_pose", "latitude", r"lat|latitude", ("angle",), "deg"),
    _Kind("gnss_pose", "longitude", r"lon|lng|long|longitude", ("angle",), "deg"),
)
_NEEDED = ("time", "left_velocity", "right_velocity")


@dataclass(frozen=True)
class FirstMapping:
    """A mapping as text, and what is to be checked in it."""

    text: str
    found: Mapping[str, str]  # field → column and unit, as they are printed
    guessed: tuple[str, ...]  # what no name states
    unused: tuple[str, ...]  # columns


def first_mapping(log: Path, vehicle: str, parameters: Mapping[str, Any]) -> FirstMapping:
    """Of a CSV log with times, speeds of both sides, and if it has them yaw rate, latitude and longitude.

    ``parameters``: of the slip estimator, dotted, over those that follow from the columns.

    Raises:
        InputError: it is no table, or has no column that looks like one of these.
    """
    names = _names(log)
    columns = {kind: _column(kind, names) for kind in _KINDS}
    fields = {kind: found for kind, found in columns.items() if found is not None}
    lacking = [name for name in _NEEDED if name not in {kind.field for kind in fields}]
    if lacking:
        raise InputError(
            f"{log}: no column looks like {', '.join(lacking)} among {', '.join(names)}; "
            "accepted: --mapping with a file that names them (docs/import.md)"
        )
    topics: dict[str, dict[str, Any]] = {}
    tree: dict[str, Any] = {"vehicle": vehicle}
    for kind, (name, unit, _) in fields.items():
        (topics.setdefault(kind.topic, {}) if kind.topic else tree)[kind.field] = _Flow(
            column=name, unit=unit
        )
    guessed = [f"unit of {name}: {unit}" for name, unit, is_stated in fields.values() if not is_stated]
    if "latitude" in topics.get("gnss_pose", {}):
        stddev = load_parameters(GnssLocalizerParameters, NODE, (f"{NODE}.yaml",)).assumed_stddev.single
        topics["gnss_pose"]["stddev"] = _Flow(x=stddev, y=stddev)
        guessed.append(f"standard deviation of positions: {stddev:g} m")
    tree |= {"topics": topics, "parameters": {**_sources(topics), **parameters}}
    head = f"# What is what in {log.name}, by trackslip import. Correct it; docs/import.md has every key.\n"
    used = {name for name, _, _ in fields.values()}
    return FirstMapping(
        text=head + yaml.dump(tree, Dumper=_Dumper, sort_keys=False, allow_unicode=True),
        found={kind.field: f"{name}, {unit}" for kind, (name, unit, _) in fields.items()},
        guessed=tuple(guessed),
        unused=tuple(name for name in names if name not in used),
    )


def _names(log: Path) -> list[str]:
    """Of all columns."""
    refuse_other_kinds(log)
    try:
        with log.open(encoding=encoding_of(log), newline=None) as stream:
            lines = list(islice(lines_of(log, stream), _LINES))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{log}: cannot be read ({error})") from error
    return [name for name in find_head(log, lines, Dialect(), ()).names if name]


def _column(kind: _Kind, names: list[str]) -> tuple[str, str, bool] | None:
    """Name, unit, and whether the name states it, of the first column of a kind."""
    for name in names:
        for stem, unit in _readings(name):
            is_of_kind = not unit or any(unit in UNITS[quantity] for quantity in kind.quantities)
            if is_of_kind and re.fullmatch(kind.names, stem):
                return name, unit or kind.usual, bool(unit)
    return None


def _readings(name: str) -> Iterator[tuple[str, str]]:
    """A name without its unit, and the unit; then the whole name, which states none."""
    words = re.sub(r"[\W_]+", "_", name.lower()).strip("_")
    if in_brackets := re.search(r"[\[(]\s*([^\])]+?)\s*[\])]", name):
        stem = re.sub(r"[\W_]+", "_", name[: in_brackets.start()].lower()).strip("_")
        yield stem, _SPELT.get(in_brackets[1].lower(), in_brackets[1])
    known = {**_SPELT, **{unit: unit for units in UNITS.values() for unit in units if unit.isalpha()}}
    for end, unit in known.items():
        if words.endswith(f"_{end}"):
            yield words.removesuffix(f"_{end}"), unit
    yield words, ""


def _sources(topics: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters that follow from which topics there are."""
    found: dict[str, Any] = {"encoder_resolution": 0.0}  # speeds, not counts
    if "gnss_pose" in topics:
        found |= {"pose_sources": ["gnss_pose"], "sources": {"gnss_pose": {"use_heading": False}}}
    else:
        found |= {"pose_sources": [""], "start": "initial_pose"}
    return found | ({} if "imu/data_raw" in topics else {"yaw_rate_sources": [""]})


class _Flow(dict[str, Any]):
    """A mapping that stands on one line."""


class _Dumper(yaml.SafeDumper):
    """Of mappings as a person writes them."""


_Dumper.add_representer(
    _Flow, lambda dumper, tree: dumper.represent_mapping("tag:yaml.org,2002:map", tree, flow_style=True)
)
