# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Hooks of MkDocs: pages that lie outside ``docs/``, links to files that are no pages, pages of the API."""

import re
from pathlib import Path, PurePosixPath
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

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

API: dict[str, tuple[str, tuple[str, ...]]] = {  # page → what it begins with, modules
    "terramechanics": (
        "# Terramechanics\n\nFormulas of Le (1999), Bekker, Reece and Wong; they take scalars and arrays, in SI units.\n\n"
        "```python\nfrom trackslip_estimation.terramechanics.strength import thrust_limit\n"
        "from trackslip_estimation.terramechanics.traction import slip_of_thrust, thrust\n\n"
        "limit = thrust_limit(cohesion=1040.0, friction_angle=0.49, area=0.58, weight=12557.0)  # N, one track\n"
        "pull = thrust(slip=0.1, limit=limit, modulus=0.01, length=1.264)  # N\n"
        "slip_of_thrust(pull, limit, 0.01, 1.264)  # 0.1\n```\n",
        tuple(
            f"trackslip_estimation.terramechanics.{name}"
            for name in ("strength", "traction", "turning", "resistance", "sinkage", "hydraulics")
        ),
    ),
    "machine": (
        "# Vehicles, soils, parameters\n\n"
        "```python\nfrom trackslip_common.soils import load_soils\nfrom trackslip_common.vehicle_files import load_vehicle\n\n"
        'load_vehicle("excavator_20t").kinematics.tread  # m\nload_soils()["sand"].friction_angle  # rad\n```\n',
        tuple(
            f"trackslip_common.{name}"
            for name in ("vehicle", "vehicle_files", "soils", "parameters", "topics", "errors")
        ),
    ),
    "bags": (
        "# Bags\n\n"
        "```python\nfrom trackslip_bags.reader import open_bag\n\n"
        'with open_bag("bags/slalom_sand") as bag:\n    print(bag.duration_s, sorted(bag.topics))\n```\n',
        tuple(f"trackslip_bags.{name}" for name in ("reader", "writer", "tables")),
    ),
    "replay": (
        "# Replay, check, report\n\n"
        "The commands call these modules. They may change; the public API is [listed](../contributing.md#versions).\n",
        ("trackslip_tools.replay.run", "trackslip_tools.replay.scoring", "trackslip_tools.check.bag"),
    ),
    "estimators": (
        "# Estimators\n\nThe cores of the nodes, without ROS.\n",
        (
            "trackslip_estimation.slip.estimator",
            "trackslip_estimation.slip.measurements",
            "trackslip_estimation.soil.soil_estimator",
        ),
    ),
    "protocols": (
        "# Protocols of devices\n\nBytes become records; nothing here knows ROS or a port.\n",
        (
            "trackslip_drivers.protocols.watson",
            "trackslip_drivers.protocols.sick_scan",
            "trackslip_drivers.protocols.nmea_stream",
            "trackslip_drivers.protocols.can_roles",
        ),
    ),
}


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add the pages that lie elsewhere, and those of the API."""
    for source, name in OUTSIDE.items():
        if source != "docs/README.md":
            text = relinked((ROOT / source).read_text(encoding="utf-8"), PurePosixPath(source).parent)
            files.append(File.generated(config, name, content=text))
    lines = ["# Python modules", "", "By what they are for:", ""]
    for name, (head, modules) in API.items():
        listed = "\n\n".join(f"::: {module}" for module in modules)
        files.append(File.generated(config, f"api/{name}.md", content=f"{head}\n{listed}\n"))
        lines.append(f"- [{head.splitlines()[0].lstrip('# ')}]({name}.md)")
    files.append(File.generated(config, "api/index.md", content="\n".join(lines) + "\n"))
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, **_: Any) -> str:
    """Lead links out of ``docs/`` to the pages above, or leave their text alone."""
    if page.file.generated_by:
        return markdown
    return relinked(markdown, PurePosixPath("docs") / PurePosixPath(page.file.src_uri).parent)


def relinked(text: str, folder: PurePosixPath) -> str:
    """Links of a file in this folder of the repository as links of a page at the top of the site."""

    def replaced(found: re.Match[str]) -> str:
        picture, words, path, anchor = found[1], found[2], found[3], found[4] or ""
        if re.match(r"[a-z]+:", path):
            return found[0]
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
