# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A first mapping for one CSV log, from the names of its columns; a user reads and corrects it."""

import re
from collections.abc import Callable, Iterator, Mapping
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
    is_name: Callable[[str], object]
    quantities: tuple[str, ...]
    usual: str  # unit where the name has none


_COUNTS = {"tick", "ticks", "count", "counts", "pulse", "pulses", "enc", "encoder"}
_POSITIONS = _COUNTS | {"pos", "position", "angle"}
_INCREMENTS = {"delta", "d", "inc", "increment", "increments"}
_PARTS = {"wheel", "track", "sprocket", "motor"}
_COUNTS_PER_TURN = 1000  # guessed, and said to be


def _speed(side: str) -> Callable[[str], object]:
    word = "(?:speed|vel|velocity|track|wheel|sprocket|motor|measured|meas|v|w|omega)"
    return re.compile(f"(?:{word}_?)*(?:{side}|{side[0]})(?:_?{word})*").fullmatch


def _position(side: str) -> Callable[[str], bool]:
    def is_name(stem: str) -> bool:
        words = set(stem.split("_"))
        others = words - {side, side[0]}
        return bool(others < words and others & _POSITIONS and others <= _POSITIONS | _PARTS | _INCREMENTS)

    return is_name


def _named(names: str) -> Callable[[str], object]:
    return re.compile(names).fullmatch


_KINDS = (
    _Kind("", "time", _named(r"t|time|stamp|timestamp|seconds?|secs?"), ("time",), "s"),
    _Kind("sprockets", "left_velocity", _speed("left"), ("speed", "angular rate"), "m/s"),
    _Kind("sprockets", "right_velocity", _speed("right"), ("speed", "angular rate"), "m/s"),
    _Kind("sprockets", "left_position", _position("left"), ("angle",), "rad"),
    _Kind("sprockets", "right_position", _position("right"), ("angle",), "rad"),
    _Kind(
        "imu/data_raw",
        "angular_velocity_z",
        _named(r"(?:gyro|g|w|omega|rate|angular_velocity)_?z|yaw_?rate|turn_?rate"),
        ("angular rate",),
        "rad/s",
    ),
    _Kind("gnss_pose", "latitude", _named(r"lat|latitude"), ("angle",), "deg"),
    _Kind("gnss_pose", "longitude", _named(r"lon|lng|long|longitude"), ("angle",), "deg"),
    _Kind(
        "gnss_pose", "x", _named(r"x|e|east|easting|(?:gnss|gps|(?:\w+_)?pos(?:ition)?)_x"), ("length",), "m"
    ),
    _Kind(
        "gnss_pose",
        "y",
        _named(r"y|n|north|northing|(?:gnss|gps|(?:\w+_)?pos(?:ition)?)_y"),
        ("length",),
        "m",
    ),
)
_PAIRS = (  # of which a log has both or none; the first one counts
    (("left_velocity", "right_velocity"), ("left_position", "right_position")),
    (("latitude", "longitude"), ("x", "y")),
)


@dataclass(frozen=True)
class FirstMapping:
    """A mapping as text, and what is to be checked in it."""

    text: str
    found: Mapping[str, str]  # field → column and unit, as they are printed
    guessed: tuple[str, ...]  # what no name states
    unused: tuple[str, ...]  # columns


def first_mapping(log: Path, vehicle: str, parameters: Mapping[str, Any]) -> FirstMapping:
    """Of a CSV log with times, speeds or positions of both sides, and if it has them yaw rate and places.

    ``parameters``: of the slip estimator, dotted, over those that follow from the columns.

    Raises:
        InputError: it is no table, or has no column that looks like one of these.
    """
    names = _names(log)
    fields = _one_of_each_pair({kind: found for kind in _KINDS if (found := _column(kind, names))})
    lacking = [
        " or ".join(either)
        for either in (("time",), ("left_velocity", "left_position"), ("right_velocity", "right_position"))
        if not set(either) & {kind.field for kind in fields}
    ]
    if lacking:
        raise InputError(
            f"{log}: no column looks like {', '.join(lacking)} among {', '.join(names)}; "
            "accepted: --mapping with a file that names them (docs/import.md)"
        )
    topics: dict[str, dict[str, Any]] = {}
    tree: dict[str, Any] = {"vehicle": vehicle}
    for kind, found in fields.items():
        (topics.setdefault(kind.topic, {}) if kind.topic else tree)[kind.field] = found.entry
    guessed = [f"unit of {one.name}: {one.unit}" for one in fields.values() if not one.is_stated]
    guessed += [
        f"counts of {one.name}: {_COUNTS_PER_TURN} a turn ('scale')"
        for one in fields.values()
        if one.is_counted
    ]
    if "gnss_pose" in topics:
        stddev = load_parameters(GnssLocalizerParameters, NODE, (f"{NODE}.yaml",)).assumed_stddev.single
        topics["gnss_pose"]["stddev"] = _Flow(x=stddev, y=stddev)
        guessed.append(f"standard deviation of positions: {stddev:g} m")
    tree |= {"topics": topics, "parameters": {**_sources(topics), **parameters}}
    head = f"# What is what in {log.name}, by trackslip import. Correct it; docs/import.md has every key.\n"
    used = {one.name for one in fields.values()}
    return FirstMapping(
        text=head + yaml.dump(tree, Dumper=_Dumper, sort_keys=False, allow_unicode=True),
        found={kind.field: f"{one.name}, {one.unit}" for kind, one in fields.items()},
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


class _Found(NamedTuple):
    """A column of a kind."""

    name: str
    unit: str
    is_stated: bool  # the unit, by the name
    is_counted: bool
    has_increments: bool

    @property
    def entry(self) -> "_Flow":
        """Of the mapping."""
        scale = {"scale": 1.0 / _COUNTS_PER_TURN} if self.is_counted else {}
        increments = {"increments": True} if self.has_increments else {}
        return _Flow(column=self.name, unit=self.unit, **scale, **increments)


def _column(kind: _Kind, names: list[str]) -> _Found | None:
    """The first column of a kind."""
    for name in names:
        for stem, unit in _readings(name):
            is_of_kind = not unit or any(unit in UNITS[quantity] for quantity in kind.quantities)
            if not is_of_kind or not kind.is_name(stem):
                continue
            is_position, words = kind.field.endswith("_position"), set(stem.split("_"))
            if is_position and not unit and words & _COUNTS:
                return _Found(name, "rev", True, True, bool(words & _INCREMENTS))
            return _Found(
                name, unit or kind.usual, bool(unit), False, is_position and bool(words & _INCREMENTS)
            )
    return None


def _one_of_each_pair(fields: Mapping[_Kind, _Found]) -> dict[_Kind, _Found]:
    """Without half a pair, and without what another pair says already."""
    found, left_out = {kind.field for kind in fields}, set()
    for pairs in _PAIRS:
        whole = next((pair for pair in pairs if set(pair) <= found), ())
        left_out |= {name for pair in pairs for name in pair if name not in whole}
    return {kind: one for kind, one in fields.items() if kind.field not in left_out}


def _readings(name: str) -> Iterator[tuple[str, str]]:
    """A name without its unit, and the unit; then the whole name, which states none."""
    words = re.sub(r"[\W_]+", "_", re.sub("(?<=[a-z])(?=[A-Z])", "_", name).lower()).strip("_")
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
    if "gnss_pose" in topics:
        found = {"pose_sources": ["gnss_pose"], "sources": {"gnss_pose": {"use_heading": False}}}
    else:
        found = {"pose_sources": [""], "start": "initial_pose"}
    return found | ({} if "imu/data_raw" in topics else {"yaw_rate_sources": [""]})


class _Flow(dict[str, Any]):
    """A mapping that stands on one line."""


class _Dumper(yaml.SafeDumper):
    """Of mappings as a person writes them."""


_Dumper.add_representer(
    _Flow, lambda dumper, tree: dumper.represent_mapping("tag:yaml.org,2002:map", tree, flow_style=True)
)
