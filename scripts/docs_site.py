# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""MkDocs hooks: pages outside ``docs/``, links to files that are not pages, pages of the API."""

import re
from pathlib import Path, PurePosixPath
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from mkdocs.utils import get_relative_url

ROOT = Path(__file__).resolve().parents[1]
OUTSIDE = {  # file of the repository → page of the site
    "README.md": "index.md",
    "docs/README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "vulnerabilities.md",
    "CODE_OF_CONDUCT.md": "conduct.md",
    "deploy/README.md": "deploy.md",
}
_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s#]+)(#[^)\s]*)?\)")
_SHIM = "https://unpkg.com/iframe-worker/shim"
API = ROOT / "scripts" / "api_pages"  # Markdown, with a line ::: MODULE for each module


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add the pages outside ``docs/``, and those of the API."""
    for source, name in OUTSIDE.items():
        if source != "docs/README.md":
            text = relink((ROOT / source).read_text(encoding="utf-8"), PurePosixPath(source).parent)
            files.append(File.generated(config, name, content=text))
    for page in sorted(API.glob("*.md")):
        files.append(File.generated(config, f"api/{page.name}", content=page.read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, **_: Any) -> str:
    """Point links out of ``docs/`` to pages of the site, or keep only their text."""
    if page.file.generated_by:
        return markdown
    return relink(markdown, PurePosixPath("docs") / PurePosixPath(page.file.src_uri).parent)


def on_post_page(output: str, *, page: Page, **_: Any) -> str:
    """Load the theme's search script for pages opened as files from the site, not from the network."""
    return output.replace(_SHIM, get_relative_url("offline_search.js", page.url))


def relink(text: str, folder: PurePosixPath) -> str:
    """Convert the links of a file in ``folder`` of the repository to links of a page at the site's top."""

    def replaced(match: re.Match[str]) -> str:
        picture, words, path, anchor = match[1], match[2], match[3], match[4] or ""
        if re.match(r"[a-z]+:", path):
            return match[0]
        target = _normal(folder / path)
        if target in OUTSIDE:
            return f"[{words}]({OUTSIDE[target]}{anchor})"
        inside = target.removeprefix("docs/")
        return f"{picture}[{words}]({inside}{anchor})" if inside != target else words

    return _LINK.sub(replaced, text)


def _normal(path: PurePosixPath) -> str:
    parts: list[str] = []
    for part in path.parts:
        if part == "..":
            parts.pop()
        elif part != ".":
            parts.append(part)
    return "/".join(parts)
