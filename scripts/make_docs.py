# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The documents as a site in ``out/docs``: reference pages, MkDocs with strict links, a readability count."""

import os
import subprocess
import sys
from pathlib import Path

import readability
import reference_pages
from trackslip_common.errors import ExitCode

ROOT = Path(__file__).resolve().parents[1]
OUTPUT = ROOT / "out" / "docs"
LONGEST_MEAN = 20.0  # words a sentence


def main() -> int:
    """Write the reference pages, build the site, count; returns the exit code."""
    reference_pages.main()
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--clean"]
    quiet = os.environ | {"NO_MKDOCS_2_WARNING": "true", "DISABLE_MKDOCS_2_WARNING": "true"}
    if subprocess.run([*command, "--site-dir", str(OUTPUT)], cwd=ROOT, env=quiet, check=False).returncode:
        return ExitCode.FAILED
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
    counts = {page.name: readability.count(page.read_text(encoding="utf-8")) for page in pages}
    print("words a sentence:      mean  longest  sentences")
    for name, found in counts.items():
        if found.sentences:
            note = "  long" if found.mean > LONGEST_MEAN else ""
            print(f"  {name:20s} {found.mean:5.1f}  {found.longest:7d}  {found.sentences:9d}{note}")
    sentences = sum(found.sentences for found in counts.values())
    mean = sum(found.mean * found.sentences for found in counts.values()) / sentences
    print(f"  {'all':20s} {mean:5.1f}")
    print(f"{sum(1 for _ in OUTPUT.rglob('*.html'))} pages: {OUTPUT / 'index.html'}")
    return ExitCode.DONE


if __name__ == "__main__":
    sys.exit(main())
