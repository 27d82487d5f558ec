# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A licence in every file; one version of all packages."""

import re
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[2]


def test_every_file_of_code_names_its_licence_and_who_holds_it() -> None:
    listed = subprocess.check_output(
        ["git", "ls-files", "*.py", "*.xml", "*.js", "*.css", "*.sh"], cwd=ROOT, text=True
    )
    files = [ROOT / name for name in listed.splitlines()]
    assert len(files) > 500
    heads = {file: file.read_text(encoding="utf-8")[:400] for file in files if file.is_file()}
    for tag in ("SPDX-FileCopyrightText: 2026 Trackslip authors", "SPDX-License-Identifier: Apache-2.0"):
        assert [str(file) for file, head in heads.items() if head and tag not in head] == []


def test_all_packages_state_one_version_one_home_and_one_level() -> None:
    """A release changes them together: CONTRIBUTING.md lists where."""
    stated = set()
    for package in sorted(ROOT.glob("src/*/package.xml")):
        about = ElementTree.parse(package).getroot()
        urls = tuple((url.get("type"), url.text) for url in about.iter("url"))
        level = re.search(
            r"\*\*level (\d)\*\*", (package.parent / "QUALITY_DECLARATION.md").read_text("utf-8")
        )
        email = about.find("maintainer").get("email")  # type: ignore[union-attr]
        stated.add((about.findtext("version"), urls, email, level and level[1]))
        setup = package.parent / "setup.py"
        if setup.is_file():
            text = setup.read_text(encoding="utf-8")
            assert f'version="{about.findtext("version")}"' in text
            assert f'maintainer_email="{email}"' in text
    ((version, urls, email, level),) = stated
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert [kind for kind, _ in urls] == ["repository", "bugtracker"]
    has_home = not any("trackslip.invalid" in str(address) for address in (*urls, email))
    assert level == "4" or (
        has_home and not str(version).startswith("0.")
    )  # REP-2004: 1.ii and 2.i of level 3


def test_the_tests_of_a_module_belong_to_one_worker(request: pytest.FixtureRequest) -> None:
    """xdist reads the group from the name of a test; without it every worker makes a module's fixtures."""
    is_shared_out = getattr(request.config.option, "loadgroup", False)  # of xdist, in its workers
    assert request.node.nodeid.endswith("@tests/common/test_house.py") == is_shared_out
