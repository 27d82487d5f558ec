# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Reference pages match the current declarations; every page is in the site's navigation."""

import re

import pytest
import yaml
from fixtures.documents import ROOT

import reference_pages
from trackslip_common.topics import TOPICS

GENERATED = ("index.md", "contributing.md", "vulnerabilities.md", "conduct.md", "deploy.md")


@pytest.mark.parametrize("name", sorted(reference_pages.WRITTEN))
def test_reference_page_is_current(name: str) -> None:
    text = (ROOT / "docs" / name).read_text(encoding="utf-8")
    assert text == reference_pages.page(name), "make docs writes it"


def test_each_node_has_its_parameters_on_the_page() -> None:
    starts = set()
    for file in ROOT.glob("src/*/setup.py"):
        starts |= set(re.findall(r'"(\w+) = \w+\.executables:\w+"', file.read_text(encoding="utf-8")))
    assert starts - {"demo"} == set(reference_pages.NODES)


def test_each_topic_and_message_is_on_the_page() -> None:
    text = reference_pages.page("topics.md")
    missing = [name for name in TOPICS if f"`{name}`" not in text and f"`/{name}`" not in text]
    missing += [
        file.stem for file in reference_pages.MESSAGES.glob("*.msg") if f"### {file.stem}\n" not in text
    ]
    assert missing == []


def test_a_bar_in_a_cell_is_no_border() -> None:
    assert list(reference_pages.table(("a", "b"), [("|D|", "")])) == [
        "| a |",
        "|---|",
        "| \\|D\\| |",
        "",
    ]


def test_each_page_is_in_the_navigation() -> None:
    nav = re.sub(r"!\S+ ", "", (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:")[2])
    listed = set(re.findall(r"[\w/-]+\.md", yaml.safe_dump(yaml.safe_load("nav:" + nav))))
    existing = {file.name for file in (ROOT / "docs").glob("*.md")} - {"README.md"}
    assert {name for name in listed if "/" not in name} == existing | set(GENERATED)
