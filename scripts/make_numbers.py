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
from measurements.blocks import ROOT, names_on, rewrite_blocks
from measurements.workbench import NotMeasured
from trackslip_common.errors import ExitCode
from trackslip_tools.cli.progress import iterate_with_bar
from trackslip_tools.workers import core_count, open_workers


def measure_block(_: None, name: str) -> tuple[str, str, str]:
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
    requested = {Path(page).stem for page in parser.parse_args().pages}
    page_of_block = names_on(lambda page: not requested or page.stem in requested)
    if missing := requested - {page.stem for page in page_of_block.values()}:
        print(f"no figures to write on: {', '.join(sorted(missing))}", file=sys.stderr)
        return ExitCode.BAD_INPUT
    is_incomplete = False
    with open_workers(min(core_count(), len(page_of_block))) as map_items:
        running = map_items(measure_block, [name for name in MEASUREMENTS if name in page_of_block])
        for name, content, reason in iterate_with_bar(running, "measurements", total=len(page_of_block)):
            page = page_of_block[name]
            text = page.read_text(encoding="utf-8")
            new = text if reason else rewrite_blocks(text, {name: content})
            page.write_text(new, encoding="utf-8")
            state = f"left: {reason}" if reason else "the same" if new == text else "written"
            print(f"{page.relative_to(ROOT)}: {name}: {state}", flush=True)
            is_incomplete |= bool(reason)
    return ExitCode.FAILED if is_incomplete else ExitCode.DONE


if __name__ == "__main__":
    sys.exit(main())
