# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The estimators over columns: an import and a replay in a directory that is removed after it."""

import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import yaml
from numpy.typing import NDArray

from trackslip._replay import Result, replayed
from trackslip_bags.importing.importer import Imported, import_log
from trackslip_bags.importing.mapping import read_mapping
from trackslip_bags.importing.roles import QUATERNION, ROLE_OF_TOPIC
from trackslip_bags.reader import open_bag
from trackslip_common.compiling import compilation_announced
from trackslip_common.errors import InputError, collected, suggestion
from trackslip_common.parameters import flatten
from trackslip_estimation.slip.sources import group_name
from trackslip_tools.cli.replay_options import ReplayOptions

REFERENCE = "reference_pose"  # is scored against, and no source

# List of sources of the estimator, by the role of a topic.
_LISTS = {
    "pose": "pose_sources",
    "imu": "yaw_rate_sources",
    "heading": "heading_sources",
    "odometry": "odometry_sources",
}
_HEADINGS = {"yaw", "heading", *QUATERNION}


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

    A source is a topic with its columns, in the words of a mapping file of ``trackslip import``
    (docs/import.md); ``(column, unit)`` is short for ``{column: …, unit: …}``. ``reference_pose`` is what
    estimates are scored against. Poses without a heading are used as those of one antenna.
    """

    def __init__(
        self,
        vehicle: str | Mapping[str, Any],
        sources: Mapping[str, Mapping[str, Any]],
        *,
        time: tuple[str, str] = ("t", "s"),
        parameters: Mapping[str, Any] | None = None,
    ) -> None:
        """Columns are checked when a frame is there.

        Args:
            vehicle: a name of ``config/vehicles``, a file, or its groups: ``{"kinematics": {…}}``.
            sources: topic → field → (column, unit), or a further key of a mapping file.
            time: column of the stamps and its unit: ``s``, ``ms``, ``us``, ``ns`` or ``iso8601``.
            parameters: of the slip estimator, nested or dotted, over what the sources imply.
        """
        self._topics = {topic: _in_full(source) for topic, source in sources.items()}
        stated = flatten(parameters or {})
        self._mapping = {
            "time": {"column": time[0], "unit": time[1]},
            "topics": self._topics,
            "vehicle": vehicle if isinstance(vehicle, str) else dict(vehicle),
            "parameters": {**_implied(self._topics), **stated},
        }
        self._names = list(dict.fromkeys(_columns(self._mapping)))

    def run(self, frame: Any) -> Result:
        """Estimate from the columns of a data frame of pandas or polars, or a mapping of name → (n,) array.

        Rows are in the order of their time; a cell that is nan has no value, so that sources of other rates
        share a frame.

        Raises:
            InputError: a column is missing or of another length, or a source, unit or parameter is refused.
        """
        table = pl.DataFrame({name: _column(frame, name) for name in self._names})
        with tempfile.TemporaryDirectory(prefix="trackslip_") as folder, compilation_announced():
            mapping, log, bag = (Path(folder) / name for name in ("sources", "frame.csv", "bag"))
            mapping.write_text(yaml.safe_dump(self._mapping), encoding="utf-8")
            table.write_csv(log)
            with collected() as notes:
                try:
                    imported = import_log([log], read_mapping(mapping), bag)
                    with open_bag(bag) as opened:
                        notes += _notes(imported)
                        return replayed(opened, ReplayOptions(), (None, (), None), notes, imported.datum)
                except InputError as error:
                    raise InputError(str(error).replace(f"{folder}/", "")) from error


def _in_full(source: Mapping[str, Any]) -> dict[str, Any]:
    """With ``(column, unit)`` as a mapping file has it."""
    return {
        key: {"column": value[0], "unit": value[1]} if isinstance(value, tuple) else value
        for key, value in source.items()
    }


def _implied(topics: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Lists of sources by the roles of the topics; of a pose without a heading, that it has none."""
    lists: dict[str, list[str]] = {name: [] for name in _LISTS.values()}
    found: dict[str, Any] = {"encoder_resolution": 0.0}  # speeds, not counts
    for topic, source in topics.items():
        role = str(source.get("role", ROLE_OF_TOPIC.get(topic)))
        if role not in _LISTS or topic == REFERENCE:
            continue
        lists[_LISTS[role]].append(topic)
        if role == "pose" and not _HEADINGS & source.keys():
            found[f"sources.{group_name(topic)}.use_heading"] = False
    start = {} if lists["pose_sources"] else {"start": "initial_pose"}
    return {**{name: topics or [""] for name, topics in lists.items()}, **start, **found}


def _columns(tree: Any) -> Iterator[str]:
    """Names of the columns anywhere in a mapping."""
    if isinstance(tree, Mapping):
        for key, value in tree.items():
            if key in ("column", "new_when_changes"):
                yield from [value] if isinstance(value, str) else value
            else:
                yield from _columns(value)


def _column(frame: Any, name: str) -> NDArray[Any]:
    """(n,) of a frame of any kind.

    Raises:
        InputError: it has no such column.
    """
    known: Iterable[str] = frame.columns if hasattr(frame, "columns") else frame
    names: Sequence[str] = [str(one) for one in known]
    if name not in names:
        raise InputError(f"frame: no column '{name}'{suggestion(name, names)}")
    column = np.asarray(frame[name])
    if column.dtype.kind == "M":
        accepted = f"numbers: frame['{name}'].astype('int64') with unit 'ns'"
        raise InputError(f"frame: column '{name}' holds dates; accepted: {accepted}")
    return column


def _notes(imported: Imported) -> Iterator[str]:
    """What became of rows that are no measurement."""
    for topic, reasons in imported.left_out.items():
        for reason, count in reasons.items():
            yield f"left out: {count} of {topic}: {reason}"
    yield from imported.notes
