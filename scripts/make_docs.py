# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Pages of the packages' docstrings, in ``out/docs``; ``make docs`` runs it in the environment of ROS."""

import os
import shutil
import sys
import warnings
from html.parser import HTMLParser
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote

ROOT = Path(__file__).resolve().parents[1]
OUTPUT = ROOT / "out" / "docs"
PACKAGES = tuple(f"trackslip_{name}" for name in ("common", "drivers", "estimation", "bags", "tools", "sim"))
OF_LAUNCH = ("!trackslip_common.nodes.launching",)  # imports what the wheels of ROS lack
TEMPLATES = Path(__file__).with_name("api_pages")


class _Page(HTMLParser):
    """Links and anchors of one page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: set[str] = set()
        self.anchors: set[str] = {""}
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what leads somewhere, and what can be led to."""
        found = dict(attrs)
        self.anchors.add(found.get("id") or "")
        if tag == "a" and found.get("href"):
            self.links.add(unquote(found["href"] or ""))


def broken_links(folder: Path) -> list[str]:
    """``page: link`` of every relative link to a page or an anchor that is not there."""
    pages = {
        file.resolve(): _Page(file.read_text(encoding="utf-8")) for file in sorted(folder.rglob("*.html"))
    }
    broken = []
    for file, page in pages.items():
        for link in sorted(page.links):
            path, _, anchor = link.partition("#")
            target = (file.parent / path).resolve() if path else file
            if ":" not in path and (target not in pages or anchor not in pages[target].anchors):
                broken.append(f"{file.relative_to(folder.resolve())}: {link}")
    return broken


def main() -> int:
    """Write all pages anew, check their links; returns the exit code."""
    os.environ["NUMBA_DISABLE_JIT"] = (
        "1"  # compiled functions are then functions, with signature and docstring
    )
    import pdoc

    warnings.filterwarnings("ignore", module=r"pdoc\..*")  # names that exist for the type checker alone
    shutil.rmtree(OUTPUT, ignore_errors=True)
    pdoc.render.configure(
        docformat="restructuredtext", template_directory=TEMPLATES, footer_text="Trackslip", show_source=False
    )
    left_out = () if find_spec("launch_ros") else OF_LAUNCH
    pdoc.pdoc(*PACKAGES, *left_out, output_directory=OUTPUT)
    broken = broken_links(OUTPUT)
    for line in broken:
        print(f"broken link: {line}", file=sys.stderr)
    print(f"{sum(1 for _ in OUTPUT.rglob('*.html'))} pages: {OUTPUT / 'index.html'}")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
