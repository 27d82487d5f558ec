# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Builds the documents as a site in ``out/docs``: reference pages, MkDocs with strict links, readability."""

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import readability
import reference_pages
from trackslip_common.errors import ExitCode

ROOT = Path(__file__).resolve().parents[1]
OUTPUT = ROOT / "out" / "docs"
LONGEST_MEAN = 20.0  # words per sentence


def main() -> int:
    """Write the reference pages, build the site, print word counts; returns the exit code."""
    reference_pages.main()
    if not build_site():
        return ExitCode.FAILED
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
    print_sentence_lengths({str(page.relative_to(ROOT)): page.read_text(encoding="utf-8") for page in pages})
    print(f"{sum(1 for _ in OUTPUT.rglob('*.html'))} pages: {OUTPUT / 'index.html'}")
    return ExitCode.DONE


def print_sentence_lengths(pages: Mapping[str, str]) -> None:
    """Print the sentence lengths of each page."""
    counts = {name: readability.count(text) for name, text in pages.items()}
    print(f"{'words a sentence:':25s}  mean  longest  sentences")
    for name, count in counts.items():
        if count.sentences:
            note = "  long" if count.mean > LONGEST_MEAN else ""
            print(f"  {name:24s} {count.mean:5.1f}  {count.longest:7d}  {count.sentences:9d}{note}")
    sentences = sum(count.sentences for count in counts.values())
    mean = sum(count.mean * count.sentences for count in counts.values()) / sentences
    print(f"  {'all':24s} {mean:5.1f}")


def build_site() -> bool:
    """Build the site by MkDocs; False after any warning, such as a broken link. Warnings are printed."""
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--clean", "--site-dir", str(OUTPUT)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "true"}
    process = subprocess.run(command, cwd=ROOT, env=environment, check=False, capture_output=True, text=True)
    if process.returncode:
        shown = (line for line in process.stderr.splitlines() if not line.startswith("INFO"))
        print(*shown, sep="\n", file=sys.stderr)
    return not process.returncode


if __name__ == "__main__":
    sys.exit(main())
