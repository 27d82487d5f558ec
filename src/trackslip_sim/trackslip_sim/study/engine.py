# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Base of all studies: a grid of cells, computed in pieces, cached, and printed as tables."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing
from dataclasses import asdict, dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar, Generic, TypeVar

from trackslip_common.atomic_files import write_atomically
from trackslip_common.parameters import Parameters, parameter
from trackslip_tools.result_cache import ResultCache, key_of
from trackslip_tools.terminal_text import markdown_table
from trackslip_tools.workers import Map, open_workers

TABLE_HEADER = "<!-- Written by trackslip study. -->\n"  # of a file of tables
Workers = Callable[[Any], AbstractContextManager[Map]]  # opens workers with the data that all pieces share
Piece = TypeVar("Piece")
Result = TypeVar("Result")
NO_VALUE = "–"  # cell of a table without a value
Columns = Mapping[str, Callable[[Any], str]]
"""Head of a column → its text for a row. Trailing spaces distinguish columns with the same head."""


@dataclass(frozen=True, kw_only=True)
class GridParameters(Parameters):
    """Grid and sensor parameters common to all studies."""

    soils: tuple[str, ...] = parameter("names in config/soils.yaml")
    terrains: tuple[str, ...] = parameter("names in config/terrains, or files; empty: the scenario's own")
    sigma_xy: tuple[float, ...] = parameter("noise of the fixes, x and y", unit="m", gt=0.0, le=100.0)
    sigma_heading: float = parameter("noise of the fixes' heading", unit="rad", gt=0.0, le=3.0)
    seeds: int = parameter("runs of each cell", ge=1, le=100_000)
    sprocket_rate: float = parameter("sprocket samples", unit="Hz", ge=1.0, le=1000.0)
    gyro_rate: float = parameter("yaw rates", unit="Hz", ge=1.0, le=1000.0)
    fix_rate: float = parameter("poses", unit="Hz", ge=1.0, le=1000.0)


def in_process_workers(shared: Any) -> AbstractContextManager[Map]:
    """Workers that compute in this process."""
    return open_workers(1, shared=shared)


def map_pieces(
    function: Callable[[Any, Piece], Result], shared: Any, pieces: Sequence[Piece], workers: Workers
) -> Generator[Result, None, None]:
    """The results in order; this process computes the first, so that kernels are compiled only once."""
    if pieces:
        yield function(shared, pieces[0])
    if len(pieces) > 1:
        with workers(shared) as mapped:
            yield from mapped(function, pieces[1:])


class Study(ABC, Generic[Piece, Result]):
    """A grid of cells. Each cell is one row of a table and consists of one or more pieces.

    Attributes:
        cells: the pieces of each cell, in the order of the grid; pieces are dataclasses.
    """

    UNIT: ClassVar[str]  # name of the pieces in the progress bar
    PARAMETERS: ClassVar[Mapping[str, str]]  # option → parameter
    RESULT: ClassVar[type[Any]]  # result of a piece, a dataclass
    SOURCES: ClassVar[Sequence[ModuleType]]  # results depend on all files below the folders of these
    FILE: ClassVar[str]  # name of the tables' file

    cells: Mapping[Any, Sequence[Piece]]

    @abstractmethod
    def __init__(self, parameters: Mapping[str, Any], settings: Sequence[str]) -> None:
        """Check parameters and texts of ``--set``; raise ``InputError`` if one is refused."""

    @abstractmethod
    def depends_on(self, piece: Piece) -> Mapping[str, Any]:
        """All parameters and files on which the result of a piece depends, except the piece itself."""

    @abstractmethod
    def compute(self, pieces: Sequence[Piece], workers: Workers) -> Generator[Result, None, None]:
        """The results in the order of the pieces."""

    @abstractmethod
    def row(self, cell: Any, results: Sequence[Result]) -> Any:
        """The row of a cell, a dataclass."""

    @abstractmethod
    def markdown(self, rows: Sequence[Any]) -> str:
        """The tables."""

    def __len__(self) -> int:
        """Number of pieces."""
        return sum(map(len, self.cells.values()))

    def run(
        self, path: Path, workers: Workers = in_process_workers, *, fresh: bool = False
    ) -> Iterator[Result]:
        """Yield the results in the order of the pieces; results in the cache are not computed.

        Raises:
            InputError: the cache cannot be used, or a piece cannot be driven.
        """
        pieces = [piece for cell_pieces in self.cells.values() for piece in cell_pieces]
        keys = [self._key(piece) for piece in pieces]
        cache: ResultCache[Result] = ResultCache(path, self.RESULT, "--cache", fresh=fresh)
        missing = {key: piece for key, piece in zip(keys, pieces, strict=True) if key not in cache}
        with closing(self.compute(list(missing.values()), workers)) as computed:
            for key in dict.fromkeys(keys):
                if key not in cache:
                    cache.add(key, next(computed))
                yield cache[key]

    def rows(self, results: Sequence[Result]) -> list[Any]:
        """One row per cell."""
        remaining = iter(results)
        return [self.row(cell, [next(remaining) for _ in pieces]) for cell, pieces in self.cells.items()]

    def files(self) -> tuple[str, ...]:
        """Names of the files that ``write`` writes: the tables, then the figures."""
        return (self.FILE,)

    def write(self, rows: Sequence[Any], folder: Path) -> None:
        """Write the tables as a file into an existing folder."""
        write_atomically(folder / self.files()[0], f"{TABLE_HEADER}\n{self.markdown(rows)}")

    def _key(self, piece: Any) -> str:
        return key_of({"piece": asdict(piece), **self.depends_on(piece)}, *self.SOURCES)


def table_lines(columns: Columns, rows: Sequence[Any], text_columns: int) -> list[str]:
    """The lines of a Markdown table; the first ``text_columns`` are aligned left, the others right."""
    heading = [head.rstrip() for head in columns]
    return markdown_table(heading, [[show(row) for show in columns.values()] for row in rows], text_columns)


def spaced_name(name: str) -> str:
    """A name of the configuration with spaces for underscores."""
    return name.replace("_", " ")
