# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Updates the measured numbers in the documents: ``make numbers`` (``ARGS='slopes swing'``).

Two comments on a page enclose each block and name a function of ``measurements/``, which simulates, replays,
and returns the lines of the block. Arguments are page files, with or without ``docs/`` and ``.md``. A block
that needs a missing log stays unchanged, and the exit code is 1.
"""

import argparse
import sys
import tempfile
from pathlib import Path

from measurements import MEASUREMENTS
from measurements.blocks import ROOT, names_on, rewritten
from measurements.workbench import NotMeasured
from trackslip_common.errors import ExitCode
from trackslip_tools.cli.progress import iterate_with_bar
from trackslip_tools.workers import core_count, open_workers


def measured(_: None, name: str) -> tuple[str, str, str]:
    """Name, new content of its block, and the reason if it cannot be measured; one of the two is empty."""
    with tempfile.TemporaryDirectory(prefix="trackslip_numbers_") as folder:
        try:
            return name, "".join(f"{line}\n" for line in MEASUREMENTS[name](Path(folder))), ""
        except NotMeasured as reason:
            return name, "", str(reason)


def main() -> int:
    """Measure, write the pages; returns the exit code: 1 if a block stays unchanged."""
    parser = argparse.ArgumentParser(prog="make numbers", description=__doc__)
    parser.add_argument("pages", nargs="*", metavar="PAGE", help="docs/swing.md, or swing; default: all")
    asked = {Path(page).stem for page in parser.parse_args().pages}
    found = names_on(lambda page: not asked or page.stem in asked)
    if missing := asked - {page.stem for page in found.values()}:
        print(f"no figures to write on: {', '.join(sorted(missing))}", file=sys.stderr)
        return ExitCode.BAD_INPUT
    left = False
    with open_workers(min(core_count(), len(found))) as mapped:
        running = mapped(measured, [name for name in MEASUREMENTS if name in found])
        for name, content, reason in iterate_with_bar(running, "measurements", total=len(found)):
            page = found[name]
            text = page.read_text(encoding="utf-8")
            new = text if reason else rewritten(text, {name: content})
            page.write_text(new, encoding="utf-8")
            state = f"left: {reason}" if reason else "the same" if new == text else "written"
            print(f"{page.relative_to(ROOT)}: {name}: {state}", flush=True)
            left |= bool(reason)
    return ExitCode.FAILED if left else ExitCode.DONE


if __name__ == "__main__":
    sys.exit(main())
