# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of CSV logs by a mapping: one or several files on one time base, each with own columns and rate."""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from fnmatch import fnmatch
from pathlib import Path

import numpy as np

from trackslip_bags.importing.columns import CLOCK, DEGREES_MINUTES, FIRST, MINUTES, Column, TimeColumn
from trackslip_bags.importing.csv_table import NO_TIME, Requested, Table, joined, read_table
from trackslip_bags.importing.csv_text import MAX_LINE_LENGTH
from trackslip_bags.importing.fix_quality import least_variances, status_of
from trackslip_bags.importing.local import LocalFrame
from trackslip_bags.importing.mapping_topics import SIDES, CsvTopic
from trackslip_bags.importing.role_values import values_of
from trackslip_bags.importing.roles import QUATERNION, ROLES
from trackslip_bags.importing.samples import Samples, SelectedRows, Values
from trackslip_bags.importing.times import LIMIT_NS, is_clock_without_colons, time_text, unit_hint
from trackslip_common.arrays import BoolArray, FloatArray, IntArray
from trackslip_common.errors import InputError
from trackslip_common.turns import unwrap_angles
from trackslip_estimation.setup_check.count_angle import LEAST_ROUNDING_RATIO, MORE_DIGITS, rounding_of
from trackslip_estimation.setup_check.equal_runs import new_readings

_COUNTERS = tuple(2.0**bits for bits in (8, 12, 16, 24, 32))  # counts at which counters restart
_RESTARTS_NS = {  # ns after which times begin again, by their unit, and the least share of a step back
    CLOCK: ((86_400 * 10**9,), 0.5),
    MINUTES: ((3_600 * 10**9,), 0.5),
    "": ((604_800 * 10**9, 2**32 * 10**3, 2**32 * 10**6), 0.99),  # GPS week, 32 bit of µs and ms
}
_MIN_ROWS = 3  # rows of a topic, which need more than one time
_LEAST_FLOATS, _MOST_FLOATS = 50, 1000  # values that are tried for the digits of 32 bit floats
_EARTH_RADIUS = 6.37e6  # m per radian of latitude
_LEAST_ANGLE = 0.05  # rad from 0, 0, of any place on land; simulations have places nearer to it, in deg
_HELD = {  # role → columns that a log may hold
    **dict.fromkeys(("pose", "fix"), (("latitude", "longitude"), ("x", "y"))),
    "heading": (("yaw",), ("heading",), QUATERNION[2:]),
}
_MIN_ZERO_SHARE, _MIN_RUNS = 0.75, 10  # of zeros in a column, and runs of other values, for a note


def read_csv_logs(
    paths: Sequence[Path], topics: Sequence[CsvTopic], start_ns: int, local: LocalFrame
) -> tuple[list[Samples], list[str]]:
    """Samples of each topic, and notes on the files.

    Raises:
        InputError: a file cannot be read or does not fit the mapping.
    """
    files = {topic.name: _files_of(topic, paths) for topic in topics}
    tables = {}
    for parts in dict.fromkeys(files.values()):
        requested = _requested([topic for topic in topics if files[topic.name] == parts])
        tables[parts] = joined([read_table(path, requested) for path in parts])
    samples = [_samples(tables[files[topic.name]], topic, start_ns, local) for topic in topics]
    return samples, list(dict.fromkeys(note for table in tables.values() for note in table.notes))


def _files_of(topic: CsvTopic, paths: Sequence[Path]) -> tuple[Path, ...]:
    """The file of a topic, or the parts of a log, which begin alike, by the numbers in their names."""
    names = ", ".join(path.name for path in paths)
    if topic.file is None and len({_first_line(path) for path in paths}) > 1:
        raise InputError(f"{topic.where}: key 'file' is missing; accepted: a name or pattern of {names}")
    matching = [path for path in paths if topic.file is None or fnmatch(path.name, topic.file)]
    if not matching:
        raise InputError(
            f"{topic.where}.file: no file '{topic.file}'; accepted: a pattern of some of {names}"
        )
    return tuple(sorted(matching, key=_numbered_name))


def _numbered_name(path: Path) -> list[tuple[int, str]]:
    """Sorts log_9 before log_10."""
    return [(int(digits or 0), text) for digits, text in re.findall(r"(\d*)(\D*)", path.name)]


def _first_line(path: Path) -> bytes:
    """The line that tells logs of different columns apart; empty where the file cannot be read."""
    with suppress(OSError), path.open("rb") as file:
        return file.readline(MAX_LINE_LENGTH).strip()
    return b""


def _requested(topics: Sequence[CsvTopic]) -> Requested:
    """All columns of one file, each once."""
    numbers: list[str] = []
    times: list[TimeColumn] = []
    texts: list[str] = []
    for topic in topics:
        spreads = [s.value for s in topic.spreads.values() if isinstance(s.value, Column)]
        numbers += [name for column in (*topic.columns.values(), *spreads) for name in column.names]
        times += [topic.time, *([topic.received] if topic.received else [])]
        texts += [topic.new_when_changes] if topic.new_when_changes else []
        if topic.dialect != topics[0].dialect:
            raise InputError(f"{topic.where}.csv: another than {topics[0].where} has; accepted: one a file")
    return Requested(
        tuple(dict.fromkeys(numbers)),
        tuple(dict.fromkeys(times)),
        tuple(dict.fromkeys(texts)),
        topics[0].dialect,
        frozenset(name for topic in topics for name in _place_names(topic)),
    )


def _place_names(topic: CsvTopic) -> Iterator[str]:
    """Columns of latitudes and longitudes in degrees."""
    for field in ("latitude", "longitude"):
        if field in topic.columns and not topic.columns[field].degrees_minutes:
            yield from topic.columns[field].names


def _samples(table: Table, topic: CsvTopic, start_ns: int, local: LocalFrame) -> Samples:
    """Samples of one topic of a file."""
    role = ROLES[topic.role]
    stamps_ns, received_ns = _stamps(table, topic, start_ns)
    columns = _columns(table, topic, stamps_ns)
    count = len(table.lines)
    variances = {axis: spread.variances(count, table.numbers) for axis, spread in topic.spreads.items()}
    present = np.isfinite([columns[name] for name in role.required_fields(columns)])
    chosen = SelectedRows(present.any(axis=0) & _is_new(table, topic, columns))
    chosen.reject(~present.all(axis=0), "some cells are blank")
    chosen.reject(stamps_ns == NO_TIME, "no time")
    for axis in ("x", "y") if topic.role == "pose" else ():
        chosen.reject(~(variances[axis] > 0.0), f"no standard deviation of {axis} above 0")
    if topic.role == "pose" and "quality" in columns:
        least = least_variances(columns["quality"])
        chosen.reject(status_of(columns["quality"]) < 0.0, "no fix by its quality")
        for axis in ("x", "y"):  # a number is that of fixed ambiguities, a column is of each row
            if not isinstance(topic.spreads[axis].value, Column):
                variances[axis] = np.maximum(variances[axis], least)
    if topic.role == "heading" and "qw" in columns:
        is_zero = np.equal([columns[name] for name in QUATERNION], 0.0).all(axis=0)
        chosen.reject(is_zero, "holds no orientation")
    if "latitude" in columns:
        chosen.reject(_is_at_origin(table, topic, columns), "latitude and longitude are 0")
    if "latitude" in columns and topic.role == "pose" and chosen.rows.any():
        local.reject(chosen, columns, f"{topic.where}: {table.path}")
    rows = chosen.rows
    _check_times(table, topic, stamps_ns[rows])
    if not rows.any():
        reasons = ", ".join(f"{n} rows: {reason}" for reason, n in chosen.left_out.items()) or "all are blank"
        raise InputError(
            f"{topic.where}: no row of {table.path} gives a message ({reasons}); accepted: some that do"
        )
    columns = {name: array[rows] for name, array in columns.items()}
    variances = {axis: array[rows] for axis, array in variances.items()}
    _check_digits(table, topic, columns, variances)
    if topic.role == "pose":
        columns = local.with_east_north(columns)
    values = values_of(topic.role, columns, variances, stamps_ns[rows], topic.geometry)
    times = stamps_ns[rows], received_ns[rows]
    frames = [topic.frame or role.frame]
    return Samples(topic.name, topic.role, frames, *times, values, chosen.left_out, table.path.name)


def _check_times(table: Table, topic: CsvTopic, stamps_ns: IntArray) -> None:
    """Refuse rows that all have one time, as after a loss of digits; note rows that share a time."""
    distinct = len(np.unique(stamps_ns))
    if len(stamps_ns) >= _MIN_ROWS and distinct == 1:
        seconds = stamps_ns[0] * 1e-9
        raise InputError(
            f"{table.path}: column '{topic.time.name}': {len(stamps_ns)} rows at one time, {seconds:.10g} s; "
            "accepted: times that tell rows apart (were digits lost as the file was written?)"
        )
    if shared := len(stamps_ns) - distinct:
        table.notes.append(
            f"{topic.name}: {shared} of {len(stamps_ns)} rows share a time with the row before"
        )


def _check_digits(table: Table, topic: CsvTopic, columns: Values, variances: Values) -> None:
    """Refuse positions with a rounding coarser than stated; the estimator takes such steps for motion.

    Raises:
        InputError: one is.
    """
    if topic.role != "pose":
        return
    shrink = np.cos(np.median(columns["latitude"])) if "latitude" in columns else 1.0
    metres = {"x": 1.0, "y": 1.0, "latitude": _EARTH_RADIUS, "longitude": _EARTH_RADIUS * shrink}
    for name, axis in (("x", "x"), ("y", "y"), ("latitude", "y"), ("longitude", "x")):
        if name not in columns:
            continue
        stated = float(np.sqrt(np.median(variances[axis])))
        column = topic.columns[name]
        floats = _as_floats(table.numbers[column.names[0]]) * column.factor
        rounding = max(rounding_of(metres[name] * values, stated) for values in (columns[name], floats))
        if rounding > LEAST_ROUNDING_RATIO * stated:
            place = f"{table.path}: column '{topic.columns[name].names[0]}'"
            has = f"is rounded by {rounding:.2g} m, and stddev of {axis} is {stated:.2g} m"
            accepted = f"{MORE_DIGITS}, or {rounding:.2g} m or more"
            raise InputError(f"{place} {has}; accepted: {accepted}")


def _as_floats(numbers: FloatArray) -> FloatArray:
    """(n,) finite numbers as the 32 bit floats of which they are the shortest text; none if they are not."""
    numbers = numbers[np.isfinite(numbers)]
    floats = numbers.astype(np.float32)
    some = zip(numbers[:_MOST_FLOATS].tolist(), floats, strict=False)
    is_float = len(numbers) >= _LEAST_FLOATS and all(repr(number) == str(value) for number, value in some)
    return floats[: len(numbers) if is_float else 0].astype(np.float64)


def _present_values(numbers: FloatArray, column: Column) -> FloatArray:
    """(n,) values in the column's own unit, or sums of increments; nan where a number marks none."""
    values = np.where(np.isin(numbers, column.missing), np.nan, numbers) if column.missing else numbers
    if column.degrees_minutes:
        degrees = np.trunc(values / 100.0)
        values = degrees + (values - 100.0 * degrees) / 60.0
    return np.where(np.isnan(values), np.nan, np.nancumsum(values)) if column.increments else values


def _note_zeros(table: Table, topic: CsvTopic) -> None:
    """Note columns that are mostly 0 with other values in between: 0 may mark a missing value."""
    for name in sorted({n for c in topic.columns.values() if not c.missing for n in c.names}):
        is_zero = table.numbers[name] == 0.0
        runs = int(np.count_nonzero(np.diff(is_zero.astype(np.int8)) < 0))
        if is_zero.mean() >= _MIN_ZERO_SHARE and runs >= _MIN_RUNS:
            percent = round(100.0 * float(is_zero.mean()))
            table.notes.append(
                f"column '{name}' is 0 in {percent} % of its rows; if 0 stands for no value: missing: 0"
            )


def _columns(table: Table, topic: CsvTopic, stamps_ns: IntArray) -> Values:
    """(rows,) values of each column, SI; angles of sprockets may restart after each turn of the encoder."""
    _note_zeros(table, topic)
    numbers = {
        name: [_present_values(table.numbers[n], column) for n in column.names]
        for name, column in topic.columns.items()
    }
    si_values = {name: _to_si(numbers[name], column, topic) for name, column in topic.columns.items()}
    timed = stamps_ns != NO_TIME
    for side in SIDES if topic.role == "sprockets" else ():
        column = topic.columns.get(f"{side}_position")
        if column is None or not column.factor or column.increments:
            continue
        speeds = si_values.get(f"{side}_velocity", np.full(len(timed), np.nan)) / column.factor
        turned = [
            _unwrap_angle(table, name, values, column.turn, timed, stamps_ns, speeds)
            for name, values in zip(column.names, numbers[f"{side}_position"], strict=True)
        ]
        si_values[f"{side}_position"] = _to_si(turned, column, topic)
    return si_values


def _unwrap_angle(
    table: Table,
    name: str,
    values: FloatArray,
    turn: float,
    timed: BoolArray,
    stamps_ns: IntArray,
    speeds: FloatArray,
) -> FloatArray:
    """(rows,) continuous values of an angle that restarts after ``turn``, or of a counter; notes the latter.

    ``timed``: rows that have a time; ``speeds`` in units of the values per second.
    """
    finite = values[np.isfinite(values)]
    counters = _COUNTERS if (finite == np.round(finite)).all() else ()
    for modulus in (*((turn,) if turn else ()), *counters):
        unwrapped = values.copy()
        unwrapped[timed] = unwrap_angles(stamps_ns[timed], values[timed], speeds[timed], modulus)
        if not np.array_equal(unwrapped, values, equal_nan=True):
            if modulus != turn:
                table.notes.append(
                    f"column '{name}' restarts after {modulus:.0f}: a counter; made continuous"
                )
            return unwrapped
    return values


def _to_si(numbers: Sequence[FloatArray], column: Column, topic: CsvTopic) -> FloatArray:
    """(rows,) SI values; of sprockets, speeds and lengths on the ground become rates and angles."""
    values: FloatArray = np.mean(numbers, axis=0)
    finite = values[np.isfinite(values)]
    origin = float(column.origin) if column.origin != FIRST else float(finite[0]) if finite.size else 0.0
    scaled: FloatArray = (values - origin) * column.factor
    if topic.role == "sprockets" and topic.geometry is not None and column is not topic.columns.get("speed"):
        scaled = scaled / topic.geometry.rolling_radius if column.quantity in ("speed", "length") else scaled
    return scaled


def _stamps(table: Table, topic: CsvTopic, start_ns: int) -> tuple[IntArray, IntArray]:
    """(rows,) stamps and times of arrival; NO_TIME where the row has none."""
    times_ns = _checked_times(table, topic.time, start_ns)
    has_time = times_ns != NO_TIME
    if topic.received is None:
        back = np.flatnonzero(np.diff(times_ns[has_time]) < 0)
        if back.size:
            place = table.place(int(np.flatnonzero(has_time)[back[0] + 1]))
            before, after = (time_text(int(times_ns[has_time][back[0] + k]), topic.time) for k in (0, 1))
            raise InputError(
                f"{place}, column '{topic.time.name}' goes back from {before} to {after}; "
                "accepted: rows in the order of their time (sort them, once each; at the end of summer time "
                "record UTC), or 'received' beside them"
            )
    stamps_ns = np.where(has_time, times_ns + topic.time_offset_ns, NO_TIME)
    if topic.received is None:
        return stamps_ns, stamps_ns
    received_ns = _checked_times(table, topic.received, start_ns)
    return stamps_ns, np.where(received_ns == NO_TIME, stamps_ns, received_ns)


def _checked_times(table: Table, column: TimeColumn, start_ns: int) -> IntArray:
    """(rows,) times, ns; NO_TIME where blank."""
    raw_ns = _continued(table, column)
    if column.units == ("s",) and is_clock_without_colons(raw_ns[raw_ns != NO_TIME] * 1e-9):
        raise InputError(
            f"{table.path}: column '{column.name}' has no second 60 to 99: times of day as 143000.25; "
            f"accepted: unit: {CLOCK} for these"
        )
    times_ns = np.where(raw_ns == NO_TIME, NO_TIME, raw_ns + start_ns)
    bad = np.flatnonzero((raw_ns != NO_TIME) & ((times_ns < 0) | (times_ns >= LIMIT_NS)))
    if bad.size:
        place = f"{table.place(bad[0])}, column '{column.name}'"
        seconds = times_ns[bad[0]] * 1e-9
        if seconds < 0.0:
            raise InputError(
                f"{place}: {seconds:.3f} s is before 0; accepted: a 'start' that makes it 0 or later"
            )
        like = unit_hint(int(raw_ns[bad[0]]), column)
        raise InputError(
            f"{place}: {seconds:.12g} s is too late for a stamp{like}; accepted: less than 2^31 s"
        )
    return times_ns


def _continued(table: Table, column: TimeColumn) -> IntArray:
    """Times (rows,), ns, that go on where their clock or counter begins again; NO_TIME stays."""
    continued = table.times[column].copy()
    has_time = continued != NO_TIME
    times_ns = continued[has_time]
    steps_ns = np.diff(times_ns, prepend=times_ns[:1])
    periods_ns, share = _RESTARTS_NS[column.units[0] if column.is_clock else ""]
    for period_ns in () if column.is_iso else periods_ns:
        begins_again = steps_ns < -share * period_ns
        if begins_again.any() and times_ns.min() >= 0 and times_ns.max() <= period_ns:
            continued[has_time] += period_ns * np.cumsum(begins_again)
            table.notes.append(
                f"column '{column.name}' begins again after {period_ns * 1e-9:.10g} s; made continuous"
            )
            break
    return continued


def _is_new(table: Table, topic: CsvTopic, columns: Values) -> BoolArray:
    """(rows,) whether a row holds a new message: where the marking column changes, or a held reading.

    The first row does not count as a change: the age of its value is unknown.
    """
    is_new = np.zeros(len(table.lines), np.bool_)
    if topic.new_when_changes is None:
        return _is_new_reading(table, topic, columns)
    marks = table.texts[topic.new_when_changes]
    marked = np.flatnonzero(marks != "")
    is_new[marked[1:]] = marks[marked[1:]] != marks[marked[:-1]]
    if not is_new.any():
        raise InputError(
            f"{table.path}: column '{topic.new_when_changes}' never changes; "
            "accepted as new_when_changes: one that does"
        )
    return is_new


def _is_new_reading(table: Table, topic: CsvTopic, columns: Values) -> BoolArray:
    """(rows,) whether a row holds a new position or heading: all, but where the log holds the last one."""
    is_new = np.ones(len(table.lines), np.bool_)
    names = next((names for names in _HELD.get(topic.role, ()) if columns.keys() >= set(names)), ())
    readings = np.array([columns[name] for name in names])
    rows = np.flatnonzero(np.isfinite(readings).all(axis=0)) if names else np.arange(0)
    if rows.size:
        is_new[rows] = new_readings(readings.T[rows])
    if not is_new.all():
        per_reading = len(rows) / int(is_new[rows].sum())
        is_new[rows[0]] = False
        table.notes.append(
            f"{topic.name}: the log holds each {topic.role} for about {per_reading:.0f} rows; those that "
            "repeat it are passed over (new_when_changes: a column that shows new ones)"
        )
    return is_new


def _is_at_origin(table: Table, topic: CsvTopic, columns: Mapping[str, FloatArray]) -> BoolArray:
    """(rows,) whether latitude and longitude are both 0, as from a receiver without a fix."""
    for name, limit in (("latitude", 90.0), ("longitude", 180.0)):
        degrees = np.degrees(columns[name])
        bad = np.flatnonzero(np.abs(degrees) > limit)
        if bad.size:
            place = f"{table.place(bad[0])}, column '{topic.columns[name].names[0]}'"
            value = float(degrees[bad[0]])
            is_like_minutes = abs(value) < 100.0 * (limit + 1.0) and abs(value) % 100.0 < 60.0
            other = f"unit: {DEGREES_MINUTES}" if is_like_minutes else f"missing: {value:g}, or another unit"
            accepted = f"-{limit:g} … {limit:g} deg (or {other} in the mapping)"
            raise InputError(f"{place}: {value:g} deg is no {name}; accepted: {accepted}")
    nowhere: BoolArray = (columns["latitude"] == 0.0) & (columns["longitude"] == 0.0)
    is_place = ~nowhere & np.isfinite(columns["latitude"]) & np.isfinite(columns["longitude"])
    latitude, longitude = (np.degrees(columns[name][is_place]) for name in ("latitude", "longitude"))
    are_angles = (np.abs(latitude) < np.pi / 2.0) & (np.abs(longitude) < np.pi)
    are_angles &= np.hypot(latitude, longitude) > _LEAST_ANGLE
    if 2 * np.count_nonzero(are_angles) > len(are_angles):
        raise InputError(
            f"{topic.where}: {table.path} has latitude {np.median(latitude):.4f}, longitude "
            f"{np.median(longitude):.4f} deg, in the sea off Africa; accepted: unit: rad, if it is radians"
        )
    return nowhere
