# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The site of make docs, opened as files: it loads nothing from the network, and its search finds pages."""

import subprocess
import sys
from pathlib import Path

import pytest
from fixtures.browser import OpenPage
from fixtures.documents import ROOT


@pytest.mark.slow
def test_search_of_the_site_works_without_a_server(
    open_page: OpenPage, complaints: list[str], tmp_path: Path
) -> None:
    pytest.importorskip("mkdocs", reason="make docs installs it")
    command = [sys.executable, "-m", "mkdocs", "build", "-q", "--site-dir", str(tmp_path / "site")]
    subprocess.run(command, cwd=ROOT, check=True)
    page = open_page(1280, "file:")
    page.goto((tmp_path / "site/index.html").as_uri())
    page.click("input.md-search__input")
    page.keyboard.type("downhill slip")
    page.wait_for_selector(".md-search-result__item")
    assert page.locator(".md-search-result__item").count() > 1
    assert complaints == []
