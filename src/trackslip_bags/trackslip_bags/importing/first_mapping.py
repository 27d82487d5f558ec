# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A first mapping for one CSV log, from the names of its columns; a user reads and corrects it."""

import csv
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from trackslip_bags.importing.columns import CLOCK, CLOCKS, DAY_FIRST, DEGREES_MINUTES, ISO, MONTH_FIRST
from trackslip_bags.importing.csv_table import DECIMAL_COMMA
from trackslip_bags.importing.csv_text import COMMENT, Dialect, encoding_of, find_head, lines_of, split_cells
from trackslip_bags.importing.fix_quality import assumed_stddevs
from trackslip_bags.importing.log_kinds import require_table
from trackslip_bags.importing.times import date_unit, is_clock_without_colons, likely_unit
from trackslip_common.arrays import FloatArray
from trackslip_common.errors import InputError
from trackslip_common.units import UNITS

_LINES = 2000  # that are read for names and values

# Spellings of units in names, which cannot hold / and °.
_UNIT_SPELLINGS = {
    **{unit.replace("/", "_"): unit for units in UNITS.values() for unit in units if unit[0] not in "1°"},
    "kmh": "km/h",
    "kph": "km/h",
    "km/hr": "km/h",
    "mps": "m/s",
    "rads": "rad/s",
    "degs": "deg/s",
    "degps": "deg/s",
    "dps": "deg/s",
    "sec": "s",
    "u/min": "rpm",
    "tr/min": "rpm",
}


_UNITS = {  # by quantity, those that are no factor too
    **UNITS,
    "time": {*UNITS["time"], *CLOCKS},
    "angle": {*UNITS["angle"], DEGREES_MINUTES},
}
_STATED_UNIT = re.compile(
    r"[\[(]\s*([^\])]+?)\s*[\])]|[\s_]([^\s_\[(]*[/°][^\s_\])]*)$"
)  # in brackets, or at the end


class _FieldKind(NamedTuple):
    """A field of a mapping, and the names of its columns."""

    topic: str  # empty: the time
    field: str
    names: str  # pattern of the words of a name, without its unit
    quantities: tuple[str, ...]
    usual: str  # unit where neither name nor values state one
    is_certain: bool = False  # the name implies the usual unit
    scale: float = 1.0


_SIDES = {"left": "left|links|linke[rs]?|gauche|l", "right": "right|rechts|rechte[rs]?|droite?|r"}
_SIDE_NUMBERS = {"left": "0", "right": "1"}  # a guess, reported as such
_PART = (
    "wheels?|tracks?|sprockets?|drive|motors?|joints?|states?|field|measured|meas|actual|ist|"
    "ketten?(?:motor)?|rad|antrieb|chenille|roue|moteur"
)
_RPM = "rpm|drehzahl"
_SPEED = f"speed|vel|velocity|v|w|omega|geschwindigkeit|geschw|vitesse|{_RPM}"
_COUNTS = "ticks?|counts?|pulses?|enc|encoder|impulse?"
_INCREMENTS = "delta|d|inc|increments?"
_POSITION = f"{_COUNTS}|pos|position|angle|winkel"
_DISTANCE = "dist|distance|strecke|weg"
_TIMES = "time|stamp|timestamp|date_?time|zeit|zeitstempel|uhrzeit|temps|horodatage"
_CLOCK = "(?:(?:ros|rosbag|header|field|gps|unix|utc|system|log|sample|local|epoch|elapsed)_)*"
_ANY = r"(?:\w+_)?"
_NO_MEASUREMENT = re.compile(
    "(?:.*_)?(?:cmd|command(?:ed)?|set|setpoint|sp|target|ref|desired|goal|home|soll|consigne|"
    "std|stddev|sigma|var|variance|cov|covariance)(?:_.*)?"
)
_COUNTS_PER_TURN = 1000  # a guess, reported as such


def _side_pattern(side: str, needed: str, more: str = "") -> str:
    """Pattern of names with a side and a word of ``needed``; a side by number comes last."""
    word = f"(?:{needed}|{_PART}{more})"
    number = _SIDE_NUMBERS[side]
    return f"(?=.*(?:{needed}))(?:(?:{word}_?)*(?:{_SIDES[side]})(?:_?{word})*|(?:{word}_?)+{number})"


def _side_kinds(side: str) -> tuple[_FieldKind, ...]:
    of_speed, of_position = f"{side}_velocity", f"{side}_position"
    px4 = {"left": "1", "right": "0"}[side]  # of its WheelEncoders the first is the right one
    more = f"|{_INCREMENTS}"
    return (
        _FieldKind("sprockets", of_speed, f"{_ANY}wheel_speed_{px4}", ("angular rate",), "rad/s", True),
        _FieldKind(
            "sprockets", of_speed, _side_pattern(side, _RPM, f"|{_SPEED}"), ("angular rate",), "rpm", True
        ),
        _FieldKind(
            "sprockets",
            of_speed,
            rf"(?:(?:{_PART})_?)*(?:{_SIDES[side]})(?:_?(?:{_PART}))*",
            ("speed", "angular rate"),
            "m/s",
        ),
        _FieldKind("sprockets", of_speed, _side_pattern(side, _SPEED), ("speed", "angular rate"), "m/s"),
        _FieldKind("sprockets", of_position, f"{_ANY}wheel_angle_{px4}", ("angle",), "rad", True),
        _FieldKind("sprockets", of_position, _side_pattern(side, _POSITION, more), ("angle",), "rad"),
        _FieldKind("sprockets", of_position, _side_pattern(side, _DISTANCE, more), ("length",), "m"),
    )


# For each field, the first kind that has a column is used. The third axis of ArduPilot and PX4 points down.
_FIELD_KINDS = (
    _FieldKind(
        "",
        "time",
        rf"ts?|{_CLOCK}(?:{_TIMES})|seconds?|secs?|utc|(?:gps_)?(?:i_?)?tow|elapsed|millis|micros",
        ("time",),
        "s",
    ),
    *_side_kinds("left"),
    *_side_kinds("right"),
    _FieldKind("imu/data_raw", "angular_velocity_z", rf"{_ANY}gyr_z", ("angular rate",), "rad/s", True, -1.0),
    _FieldKind(
        "imu/data_raw", "angular_velocity_z", rf"{_ANY}gyro_rad_2", ("angular rate",), "rad/s", True, -1.0
    ),
    _FieldKind(
        "imu/data_raw",
        "angular_velocity_z",
        rf"(?:imu_?\d*_)?[gw]_?z|omega|"
        rf"{_ANY}(?:(?:gyro|omega|rate|angular_velocity)_?z|(?:yaw|turn|gier|dreh|rot(?:ation)?)_?rate(?:_z)?|"
        rf"giergeschwindigkeit|drehgeschwindigkeit|vitesse_(?:de_)?(?:lacet|rotation))",
        ("angular rate",),
        "rad/s",
    ),
    _FieldKind(
        "gnss_pose", "latitude", rf"{_ANY}(?:lat|latitude|(?:geo_?)?breite|breitengrad)", ("angle",), "deg"
    ),
    _FieldKind(
        "gnss_pose",
        "longitude",
        rf"{_ANY}(?:lon|lng|long|longitude|(?:geo_?)?l(?:ä|ae)nge|l(?:ä|ae)ngengrad)",
        ("angle",),
        "deg",
        True,
    ),
    _FieldKind(
        "gnss_pose",
        "x",
        r"x|e|(?:utm_)?east(?:ing)?|rechtswert|ost(?:wert)?|(?:gnss|gps|utm)_[xe]|(?:\w+_)?pos(?:ition)?_x",
        ("length",),
        "m",
    ),
    _FieldKind(
        "gnss_pose",
        "y",
        r"y|n|(?:utm_)?north(?:ing)?|hochwert|nord(?:wert)?|(?:gnss|gps|utm)_[yn]|(?:\w+_)?pos(?:ition)?_y",
        ("length",),
        "m",
    ),
    _FieldKind(
        "gnss_pose",
        "quality",
        r"(?:(?:gga|gps|gnss|rtk|fix|pos(?:ition)?|sol(?:ution)?)_)*(?:quality|qualit[äé]t?|qual)",
        (),
        "",
        True,
    ),
    _FieldKind("heading", "heading", rf"{_ANY}(?:heading|hdg|hdt|steuerkurs|azimuth?)", ("angle",), "deg"),
)
_TWO_COLUMN_TIMES = (  # times in two columns, and their units
    (rf"(?:{_CLOCK}stamp_)?secs?", rf"(?:{_CLOCK}stamp_)?n(?:ano)?secs?", ("s", "ns")),
    ("date|datum", "time|zeit|uhrzeit|heure", (ISO,)),
)
_PAIRS = (  # fields that come together; the first complete pair is used
    (("left_velocity", "right_velocity"), ("left_position", "right_position")),
    (("latitude", "longitude"), ("x", "y")),
)
_QUALITIES = set(range(10))  # of GGA
_LONGEST_PERIOD = 2.0  # s between rows
_DAY_NUMBERS = (36_526.0, 73_051.0)  # of a spreadsheet: 2000 to 2100
_START_OF_DAY_NUMBERS = -2_209_161_600  # s: 1899-12-30
_LARGEST_ANGLES = {"latitude": 90.0, "longitude": 180.0}  # deg
_NEGATIVE_HEMISPHERES = {"latitude": "S", "longitude": "W"}
_SCALE_OF_INTEGER_ANGLE = 1e-7  # deg per unit of the integers of MAVLink, u-blox and PX4


@dataclass(frozen=True)
class FirstMapping:
    """A mapping as text, and entries for the user to check."""

    text: str
    columns: Mapping[str, str]  # field → column and unit, as they are printed
    guessed: tuple[str, ...]  # entries that no name states
    unused: tuple[str, ...]  # names of columns


def first_mapping(log: Path, vehicle: str, parameters: Mapping[str, Any]) -> FirstMapping:
    """A mapping of a CSV log with times, speeds or positions of both sides; yaw rate and places if present.

    ``parameters``: of the slip estimator, dotted, over those that follow from the columns.

    Raises:
        InputError: it is no table, or has no column that looks like one of these.
    """
    table = _read_table(log)
    fields = _drop_repeated_pairs(_find_fields(table))
    lacking = [
        " or ".join(either)
        for either in (("time",), ("left_velocity", "left_position"), ("right_velocity", "right_position"))
        if not set(either) & fields.keys()
    ]
    if lacking:
        units = "".join(
            f"; unit of '{name}' is unknown" for name in table.cells if _has_unknown_unit(name, table)
        )
        raise InputError(
            f"{log}: no column looks like {', '.join(lacking)} among {', '.join(table.cells)}{units}; "
            "accepted: --mapping with a file that names them (docs/import.md)"
        )
    topics: dict[str, dict[str, Any]] = {}
    tree: dict[str, Any] = {"vehicle": vehicle}
    tree |= {"csv": _FlowMapping(decimal="comma")} if table.has_decimal_commas else {}
    tree |= {"start": _START_OF_DAY_NUMBERS} if fields["time"].units == ("d",) else {}
    for field, columns in fields.items():
        (topics.setdefault(columns.topic, {}) if columns.topic else tree)[field] = columns.entry
    guessed = [guess for columns in fields.values() for guess in columns.guesses]
    if "gnss_pose" in topics:
        stddev = assumed_stddevs().single
        topics["gnss_pose"]["stddev"] = _FlowMapping(x=stddev, y=stddev)
        guessed.append(f"standard deviation of positions: {stddev:g} m")
    tree |= {"topics": topics, "parameters": {**_source_parameters(topics), **parameters}}
    head = f"# What is what in {log.name}, by trackslip import. Correct it; docs/import.md has every key.\n"
    used = {name for columns in fields.values() for name in columns.names}
    return FirstMapping(
        text=head + yaml.dump(tree, Dumper=_Dumper, sort_keys=False, allow_unicode=True),
        columns={field: one.text for field, one in fields.items()},
        guessed=tuple(guessed),
        unused=tuple(name for name in table.cells if name not in used),
    )


class _Table(NamedTuple):
    """The first rows of a log."""

    cells: Mapping[str, list[str]]  # non-blank cells, by column
    units: Mapping[str, str]  # of the line below the names, by column
    has_decimal_commas: bool

    def numbers(self, name: str) -> FloatArray:
        """(n,) numbers of a column; empty where a cell is no number."""
        try:
            return np.array([float(cell.replace(",", ".")) for cell in self.cells[name]], np.float64)
        except ValueError:
            return np.empty(0)


def _read_table(log: Path) -> _Table:
    require_table(log)
    try:
        with log.open(encoding=encoding_of(log), newline=None) as stream:
            lines = list(islice(lines_of(log, stream), _LINES))
        head = find_head(log, lines, Dialect(), ())
        below = [line for line in lines[head.line :] if not line.lstrip().startswith(COMMENT)]
        rows = [split_cells(line, head.delimiter) for line in below]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{log}: cannot be read ({error})") from error
    rows = [row for row in rows if len(row) >= len(head.names)]
    first = next((k for k, row in enumerate(rows) if any(re.match(r"[+-]?\.?\d", cell) for cell in row)), 0)
    units = dict(zip(head.names, rows[0], strict=False)) if first else {}
    rows = rows[first:]
    cells = {name: [row[k] for row in rows if row[k]] for k, name in enumerate(head.names) if name}
    has_commas = any(DECIMAL_COMMA.fullmatch(cell) for column in cells.values() for cell in column)
    return _Table(cells, units, has_commas)


class _FieldColumns(NamedTuple):
    """The columns of a field."""

    topic: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    guesses: tuple[str, ...] = ()
    scale: float = 1.0
    has_increments: bool = False

    @property
    def text(self) -> str:
        """Names and units."""
        return ", ".join(" + ".join(texts) for texts in (self.names, self.units) if any(texts))

    @property
    def entry(self) -> "_FlowMapping":
        """Entry of the mapping."""
        column, unit = (list(own) if len(own) > 1 else own[0] for own in (self.names, self.units))
        stated = {"unit": unit} if unit else {}
        scale = {} if self.scale == 1.0 else {"scale": self.scale}
        increments = {"increments": True} if self.has_increments else {}
        return _FlowMapping(column=column, **stated, **scale, **increments)


def _find_fields(table: _Table) -> dict[str, _FieldColumns]:
    """For each field, the first column of its first kind."""
    fields: dict[str, _FieldColumns] = {}
    for kind in _FIELD_KINDS:
        column = None if kind.field in fields else _find_column(kind, table)
        if column is not None:
            fields[kind.field] = column
    if any(fields[name].units == (DEGREES_MINUTES,) for name in _LARGEST_ANGLES if name in fields):
        minutes = {name: fields[name] for name in _LARGEST_ANGLES if name in fields}
        fields |= {name: one._replace(units=(DEGREES_MINUTES,)) for name, one in minutes.items()}
    return fields | ({"time": two_columns} if (two_columns := _two_column_time(table)) else {})


def _find_column(kind: _FieldKind, table: _Table) -> _FieldColumns | None:
    for name in table.cells:
        for stem, unit in _interpretations(name, table.units.get(name, "")):
            is_of_kind = not unit or any(unit in _UNITS[quantity] for quantity in kind.quantities)
            is_of_kind &= bool(kind.quantities) or set() < set(table.numbers(name)) <= _QUALITIES
            if is_of_kind and re.fullmatch(kind.names, stem) and not _NO_MEASUREMENT.fullmatch(stem):
                return _field_columns(kind, table, name, stem, unit)
    return None


def _has_unknown_unit(name: str, table: _Table) -> bool:
    """Whether only the unit that a column states keeps it from a field."""
    stem, unit = next(_interpretations(name, table.units.get(name, "")))
    is_known = not unit or any(unit in units for units in _UNITS.values())
    return not is_known and any(re.fullmatch(kind.names, stem) for kind in _FIELD_KINDS)


def _field_columns(kind: _FieldKind, table: _Table, name: str, stem: str, unit: str) -> _FieldColumns:
    """A column of a kind, with unit, scale and guesses by its name and values."""
    scale, words = kind.scale, re.findall(r"[^\W\d_]+|\d+", stem)
    is_position, side = kind.field.endswith("_position"), kind.field.partition("_")[0]
    guesses = [f"scale of {name}: -1, of an axis that points down"] if scale < 0.0 else []
    if not kind.is_certain and words[-1] == _SIDE_NUMBERS.get(side):
        guesses.append(f"side of {name}: {side}")
    unit_by_values, is_known = _unit_by_values(kind, table, name)
    if is_known and (unit_by_values in (ISO, MONTH_FIRST, DAY_FIRST, *CLOCKS) or not unit):
        unit = unit_by_values
    elif is_position and not unit and any(re.fullmatch(_COUNTS, word) for word in words):
        unit, scale = "rev", 1.0 / _COUNTS_PER_TURN
        guesses.append(f"counts of {name}: {_COUNTS_PER_TURN} a turn ('scale')")
    elif not unit:
        unit = unit_by_values
        guesses += [] if kind.is_certain else [f"unit of {name}: {unit}"]
    values = np.abs(table.numbers(name))
    limit = _LARGEST_ANGLES.get(kind.field, np.inf)
    if unit != DEGREES_MINUTES and values.max(initial=0.0) > limit:
        if (values == np.round(values)).all():
            scale = _SCALE_OF_INTEGER_ANGLE
        elif values.max() < 100.0 * (limit + 1.0) and (values % 100.0 < 60.0).all():
            unit, guesses = DEGREES_MINUTES, [f"unit of {name}: {DEGREES_MINUTES}"]
    hemisphere = _NEGATIVE_HEMISPHERES.get(kind.field)
    is_positive = bool(values.size and (table.numbers(name) > 0.0).all())
    if is_positive and any(set(cells) == {hemisphere} for cells in table.cells.values()):
        scale = -scale
        guesses.append(f"scale of {name}: -1, of the hemisphere {hemisphere}")
    has_increments = is_position and any(re.fullmatch(_INCREMENTS, word) for word in words)
    return _FieldColumns(kind.topic, (name,), (unit,), tuple(guesses), scale, has_increments)


def _unit_by_values(kind: _FieldKind, table: _Table, name: str) -> tuple[str, bool]:
    """Unit by the values of a column, and whether it is certain: by a date it is, by a period it is not."""
    if kind.field == "heading":  # by the step from a full turn to zero
        values = table.numbers(name)
        step, largest = (np.abs(v).max(initial=0.0) for v in (np.diff(values), values))
        is_rad = np.pi < step <= largest <= 2.0 * np.pi
        return "rad" if is_rad else "gon" if 360.0 < step <= largest <= 400.0 else kind.usual, False
    if kind.field != "time" or not table.cells[name]:
        return kind.usual, False
    if unit := likely_unit(table.cells[name][0]):
        return unit, True
    numbers = table.numbers(name)
    if not numbers.size:
        return date_unit(table.cells[name]), True  # import states how a date is written
    if is_clock_without_colons(numbers):
        return CLOCK, True
    steps = np.diff(numbers)
    period = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    low, high = _DAY_NUMBERS
    if 0.0 < period * UNITS["time"]["d"] <= _LONGEST_PERIOD and ((numbers > low) & (numbers < high)).all():
        return "d", True
    units = (unit for unit in ("s", "ms", "us", "ns") if period * UNITS["time"][unit] <= _LONGEST_PERIOD)
    return next(units, kind.usual), False


def _two_column_time(table: _Table) -> _FieldColumns | None:
    """A time in two columns: seconds and nanoseconds, or a date and a time of day."""
    normalised = {name: _normalised_name(name) for name in table.cells}
    for first, second, units in _TWO_COLUMN_TIMES:
        names = tuple(
            next((name for name in normalised if re.fullmatch(pattern, normalised[name])), "")
            for pattern in (first, second)
        )
        if not all(names):
            continue
        cells = [" ".join(pair) for pair in zip(*(table.cells[name] for name in names), strict=False)]
        if units != (ISO,):
            return _FieldColumns("", names, units)
        if cells and (likely_unit(cells[0]) == ISO or "/" in cells[0]):
            return _FieldColumns("", names, (date_unit(cells),))
    return None


def _drop_repeated_pairs(fields: Mapping[str, _FieldColumns]) -> dict[str, _FieldColumns]:
    """The fields without incomplete pairs, and without pairs that repeat another one."""
    left_out: set[str] = set()
    for pairs in _PAIRS:
        complete = next((pair for pair in pairs if fields.keys() >= set(pair)), ())
        left_out |= {name for pair in pairs for name in pair if name not in complete}
        left_out |= {"quality"} if "latitude" in pairs[0] and not complete else set()
    return {field: one for field, one in fields.items() if field not in left_out}


def _normalised_name(name: str) -> str:
    """``left_speed`` of ``LeftSpeed``, ``left.speed`` and others."""
    return re.sub(r"[\W_]+", "_", re.sub("(?<=[a-z])(?=[A-Z])", "_", name).lower()).strip("_")


def _interpretations(name: str, unit_below: str) -> Iterator[tuple[str, str]]:
    """Interpretations of a name: without its unit, and the unit; then the whole name, without a unit."""
    normalised = _normalised_name(name)
    if unit_below:
        yield normalised, _unit_of_text(unit_below.strip("[]() "))
    if stated := _STATED_UNIT.search(name):
        unit = stated[1] or stated[2]
        yield _normalised_name(name[: stated.start()]), _unit_of_text(unit)
    unit_of = {
        **_UNIT_SPELLINGS,
        **{unit: unit for units in UNITS.values() for unit in units if unit.isalpha()},
    }
    for end, unit in unit_of.items():
        if normalised.endswith(f"_{end}"):
            yield normalised.removesuffix(f"_{end}"), unit
    yield normalised, ""


def _unit_of_text(text: str) -> str:
    """The unit that a name states in brackets or at its end."""
    lower = text.lower()
    if re.match("d+mm", lower):
        return DEGREES_MINUTES
    return CLOCK if lower.startswith("hh:mm") else _UNIT_SPELLINGS.get(lower, text)


def _source_parameters(topics: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters that follow from the topics."""
    parameters: dict[str, Any] = {"pose_sources": [""], "start": "initial_pose"}
    if "gnss_pose" in topics:
        parameters = {"pose_sources": ["gnss_pose"], "sources": {"gnss_pose": {"use_heading": False}}}
    parameters |= {"heading_sources": ["heading"]} if "heading" in topics else {}
    return parameters | ({} if "imu/data_raw" in topics else {"yaw_rate_sources": [""]})


class _FlowMapping(dict[str, Any]):
    """A mapping that is written on one line."""


class _Dumper(yaml.SafeDumper):
    """Writes mappings as a person does, short ones on one line."""


_Dumper.add_representer(
    _FlowMapping,
    lambda dumper, tree: dumper.represent_mapping("tag:yaml.org,2002:map", tree, flow_style=True),
)
