# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A folder with the page of each bag, and an index with the table of all."""

from collections.abc import Sequence
from pathlib import Path

from trackslip_tools.cli.outputs import write_file
from trackslip_tools.fleet.entry import Entry
from trackslip_tools.fleet.table import COLUMNS, named_entries

INDEX = "index.html"


def write_pages(entries: Sequence[Entry], folder: Path) -> None:
    """Write the pages of the entries, and the index.

    Raises:
        InputError: a file cannot be written.
    """
    from jinja2 import Environment, PackageLoader  # not needed without pages

    environment = Environment(loader=PackageLoader(__package__), autoescape=True, trim_blocks=True)
    rows, digits = [], len(str(len(entries)))
    for number, (name, entry) in enumerate(named_entries(entries), start=1):
        file = f"{number:0{digits}}.html" if entry.page else ""  # names may not suit as file names
        if entry.page:
            write_file("output", folder / file, entry.page)
        rows.append((name, file, [show(entry) for show in COLUMNS.values()], entry.error))
    page = environment.get_template("index.html").render(heads=list(COLUMNS), rows=rows)
    write_file("output", folder / INDEX, page)
