# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Runs the estimators over columns, by an import and a replay in a temporary directory."""

import os
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from trackslip._replay import Result, replay_open_bag
from trackslip._values import json_text
from trackslip_bags.importing.importer import Imported, import_log
from trackslip_bags.importing.mapping import read_mapping
from trackslip_bags.importing.roles import QUATERNION, ROLE_OF_TOPIC
from trackslip_bags.reader import open_bag
from trackslip_common.compiling import announce_compilation
from trackslip_common.errors import InputError, collect_output, suggestion
from trackslip_common.parameters import flatten
from trackslip_common.yaml_tree import section, text
from trackslip_estimation.slip.sources import group_name
from trackslip_tools.cli.replay_options import ReplayOptions

REFERENCE = "reference_pose"  # topic to score against, no source

# Role of a topic → list of sources of the estimator.
_SOURCE_LISTS = {
    "pose": "pose_sources",
    "imu": "yaw_rate_sources",
    "heading": "heading_sources",
    "odometry": "odometry_sources",
    "velocity": "velocity_sources",
    "swing": "swing_sources",
}
_process: int | None = None  # the process that was first to run an estimator
_HEADING_FIELDS = {"yaw", "heading", *QUATERNION}
_DOUBLE = 8  # bytes of the longest float of polars
_TEXT_KINDS = "biufU"  # numpy kinds that are written to a table of text without conversion


class Estimator:
    """Estimates pose, slips and soil from columns of a data frame.

        ts.Estimator(
            vehicle="excavator_20t",
            sources={
                "sprockets": {"left_velocity": ("wl", "rad/s"), "right_velocity": ("wr", "rad/s")},
                "imu/data_raw": {"angular_velocity_z": ("gz", "deg/s")},
                "gnss_pose": {
                    "latitude": ("lat", "deg"), "longitude": ("lon", "deg"), "stddev": {"x": 0.02, "y": 0.02},
                },
            },
        ).run(frame)

    A source is a topic with its columns, with the keys of a mapping file of ``trackslip import``
    (docs/import.md). ``(column, unit)`` is short for ``{column: …, unit: …}``. Estimates are scored against
    ``reference_pose``. Poses without a heading are used as those of a single antenna.
    """

    def __init__(
        self,
        vehicle: Path | str | Mapping[str, Any],
        sources: Mapping[str, Mapping[str, Any]],
        *,
        time: tuple[str, str] = ("t", "s"),
        parameters: Mapping[str, Any] | None = None,
    ) -> None:
        """Check the arguments; columns are checked in ``run``.

        Args:
            vehicle: a name of ``config/vehicles``, a file, or its groups: ``{"kinematics": {…}}``.
            sources: topic → field → (column, unit), or a further key of a mapping file.
            time: column of the stamps and its unit: ``s``, ``ms``, ``us``, ``ns`` or ``iso8601``.
            parameters: of the slip estimator, nested or dotted; override those that the sources imply.

        Raises:
            InputError: an argument has another form.
        """
        topics = {
            text("sources", topic): _expand_source(topic, source)
            for topic, source in section("sources", sources).items()
        }
        stated = flatten(section("parameters", {} if parameters is None else parameters))
        self._mapping: dict[str, Any] = {
            "time": _column_and_unit("time", time),
            "topics": topics,
            "vehicle": vehicle,
            "parameters": {**_implied_parameters(topics, stated), **stated},
        }
        self._columns_used = list(dict.fromkeys(_column_names(self._mapping)))
        self._mapping["csv"] = {"names": self._columns_used, "delimiter": "comma"}
        json_text("sources", self._mapping)

    def run(self, frame: Any) -> Result:
        """Estimate from the columns of a data frame of pandas or polars, or a mapping of name → (n,) array.

        Rows are in order of time. A cell that is nan, null or masked has no value, so that sources of
        different rates can share a frame. Dates are times of unit ``iso8601``.

        Raises:
            InputError: a column is missing or of another length, or a source, unit or parameter is rejected.
        """
        _refuse_forked_process()
        with tempfile.TemporaryDirectory(prefix="trackslip_") as folder, announce_compilation():
            mapping, log, bag = (Path(folder) / name for name in ("sources", "frame.csv", "bag"))
            mapping.write_text(json_text("sources", self._mapping), encoding="utf-8")
            with collect_output() as notes:
                try:
                    checked = read_mapping(mapping)
                    _table(frame, self._columns_used).write_csv(log, include_header=False)
                    imported = import_log([log], checked, bag)
                    with open_bag(bag) as opened:
                        notes += _import_notes(imported)
                        return replay_open_bag(opened, ReplayOptions(), notes, datum=imported.datum)
                except InputError as error:
                    raise InputError(_in_words_of_frame(str(error).replace(f"{folder}/", ""))) from error


def _in_words_of_frame(text: str) -> str:
    """An error of the import with the row of the frame, from 0, instead of the line of its table of text."""
    text = re.sub(r"frame\.csv: line (\d+)", lambda line: f"frame: row {int(line[1]) - 1}", text)
    return text.replace("frame.csv", "frame")


def _refuse_forked_process() -> None:
    """Raise InputError in a fork of a process that has run an estimator: threads of polars are not in it."""
    global _process
    _process = os.getpid() if _process is None else _process
    if _process != os.getpid():
        accepted = 'multiprocessing.get_context("spawn")'
        raise InputError(
            f"run: this process was forked from one that has run an estimator; accepted: {accepted}"
        )


def _expand_source(topic: str, source: object) -> dict[str, Any]:
    """A source with ``(column, unit)`` expanded as in a mapping file."""
    where = f"sources: {topic}"
    return {
        key: _column_and_unit(f"{where}.{key}", value) if isinstance(value, tuple) else value
        for key, value in section(where, source).items()
    }


def _column_and_unit(where: str, value: object) -> dict[str, Any]:
    """A column and its unit, as in a mapping file."""
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise InputError(f"{where}: {value!r} is not accepted; accepted: (column, unit)")
    return {"column": value[0], "unit": value[1]}


def _implied_parameters(topics: Mapping[str, Mapping[str, Any]], stated: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters that sources imply: lists by role, ``use_heading`` of poses, and ``start`` without poses.

    ``stated``: parameters of the user, by their dotted names. A pose source that they leave out has no flag.
    """
    lists: dict[str, list[str]] = {name: [] for name in _SOURCE_LISTS.values()}
    heading_flags: dict[str, Any] = {}
    poses = stated.get("pose_sources", list(topics))
    for topic, source in topics.items():
        role = str(source.get("role", ROLE_OF_TOPIC.get(topic)))
        if role == "fix":
            raise InputError(
                f"sources: {topic}: the estimator takes no fixes; accepted: role: pose, with stddev"
            )
        if role not in _SOURCE_LISTS or topic == REFERENCE:
            continue
        lists[_SOURCE_LISTS[role]].append(topic)
        if role == "pose" and topic in poses and not _HEADING_FIELDS & source.keys():
            heading_flags[f"sources.{group_name(topic)}.use_heading"] = False
    start = {} if lists["pose_sources"] else {"start": "initial_pose"}
    return {**{name: topics or [""] for name, topics in lists.items()}, **start, **heading_flags}


def _column_names(tree: Any) -> Iterator[str]:
    """Names of all columns in a mapping."""
    if isinstance(tree, Mapping):
        for key, value in tree.items():
            if key in ("column", "new_when_changes"):
                yield from value if isinstance(value, list) else [str(value)]
            else:
                yield from _column_names(value)


def _table(frame: Any, names: Sequence[str]) -> pl.DataFrame:
    """The named columns of a frame of any kind, for a table of text."""
    if isinstance(frame, pl.LazyFrame):
        frame = frame.collect()
    if not isinstance(frame, Mapping) and not hasattr(frame, "columns"):
        accepted = "a data frame of pandas or polars, or a mapping of name → array"
        raise InputError(f"frame: a {type(frame).__name__} is no table; accepted: {accepted}")
    if hasattr(frame, "reset_index") and set(names) & (set(frame.index.names) - set(frame.columns)):
        frame = frame.reset_index()  # of pandas, where the time is the index
    keys = {str(key): key for key in getattr(frame, "columns", frame)}
    keys |= {key: key for key in getattr(frame, "columns", frame) if isinstance(key, str)}  # "3" before 3
    columns: dict[str, NDArray[Any]] = {}
    for name in names:
        if name not in keys:
            index: Any = getattr(frame, "index", None)  # of pandas
            has_unnamed_dates = type(index).__name__ == "DatetimeIndex" and list(index.names) == [None]
            hint = f"; if it is the index: frame.rename_axis('{name}')" if has_unnamed_dates else ""
            raise InputError(f"frame: no column '{name}'{suggestion(name, list(keys))}{hint}")
        columns[name] = _cells(name, frame[keys[name]])
        if len(columns[name]) != len(columns[names[0]]):
            lengths = f"column '{name}' has {len(columns[name])} rows, '{names[0]}' {len(columns[names[0]])}"
            raise InputError(f"frame: {lengths}; accepted: columns of one length")
    if not len(columns[names[0]]):
        raise InputError("frame: no rows; accepted: one or more")
    return pl.DataFrame(columns)


def _cells(name: str, column: object) -> NDArray[Any]:
    """(n,) numbers or texts of a column of any kind."""
    column = np.ma.filled(column.astype(object), None) if isinstance(column, np.ma.MaskedArray) else column
    cells = np.asarray(column)
    cells = cells.astype(cells.dtype.newbyteorder("="), copy=False)
    if cells.ndim != 1:
        raise InputError(f"frame: column '{name}' has the shape {cells.shape}; accepted: (n,), a value a row")
    if cells.dtype.kind == "M":
        return np.datetime_as_string(cells)
    if cells.dtype.kind == "f" and cells.itemsize > _DOUBLE:
        return cells.astype(np.float64)
    if cells.dtype.kind == "O":
        return np.array([str(cell) for cell in cells])
    if cells.dtype.kind not in _TEXT_KINDS:
        remedy = ", as of .dt.total_seconds()" if cells.dtype.kind == "m" else ""
        raise InputError(
            f"frame: column '{name}' holds {cells.dtype}; accepted: numbers{remedy}, dates or text"
        )
    return cells


def _import_notes(imported: Imported) -> Iterator[str]:
    """Notes on rows that are no measurements."""
    for topic, reasons in imported.left_out.items():
        for reason, count in reasons.items():
            yield f"left out: {count} of {topic}: {reason}"
    yield from imported.notes
