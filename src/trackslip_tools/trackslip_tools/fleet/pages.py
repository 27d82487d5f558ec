# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A folder of pages, one of each bag, and an index with the table of all."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from trackslip_common.errors import InputError
from trackslip_common.whole_file import write_whole
from trackslip_tools.fleet.entry import Entry
from trackslip_tools.fleet.table import COLUMNS, names

INDEX = "index.html"


def make_folder(path: Path) -> None:
    """Before the work.

    Raises:
        InputError: it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--output: '{path}' cannot be a folder of pages ({error.strerror})") from error


def write_pages(entries: Sequence[Entry], folder: Path) -> None:
    """The pages that there are, and the index.

    Raises:
        InputError: one cannot be written.
    """
    from jinja2 import Environment, PackageLoader  # not for a replay without pages

    environment = Environment(loader=PackageLoader(__package__), autoescape=True, trim_blocks=True)
    rows = []
    try:
        for name, file, entry in _named(entries):
            if entry.page:
                write_whole(folder / file, entry.page)
            cells = [show(entry) for show in COLUMNS.values()]
            rows.append((name, file if entry.page else "", cells, entry.error))
        page = environment.get_template("index.html").render(heads=list(COLUMNS), rows=rows)
        write_whole(folder / INDEX, page)
    except OSError as error:
        raise InputError(f"--output: '{folder}' cannot be written ({error.strerror})") from error


def _named(entries: Sequence[Entry]) -> Iterator[tuple[str, str, Entry]]:
    """What each is called, and the file of its page; files are numbered, for names may be anybody's."""
    digits = len(str(len(entries)))
    for number, (name, entry) in enumerate(zip(names(entries), entries, strict=True), start=1):
        yield name, f"{number:0{digits}}.html", entry
