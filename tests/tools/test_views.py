# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The layouts in ``config/views/`` show existing topics, and fields of their messages."""

import json
from collections.abc import Iterator
from typing import Any

import pytest
import yaml

from trackslip_bags.messages import make
from trackslip_common.config_files import config_directory
from trackslip_common.topics import TOPICS

VIEWS = config_directory() / "views"
FOXGLOVE = json.loads((VIEWS / "foxglove.json").read_text(encoding="utf-8"))
RVIZ = yaml.safe_load((VIEWS / "trackslip.rviz").read_text(encoding="utf-8"))
PATHS = [path["value"] for panel in FOXGLOVE["configById"].values() for path in panel.get("paths", [])]


def placed(layout: Any) -> Iterator[str]:
    """Panels in order."""
    if isinstance(layout, str):
        yield layout
    else:
        yield from placed(layout["first"])
        yield from placed(layout["second"])


def test_each_panel_has_its_place_and_its_settings() -> None:
    assert sorted(placed(FOXGLOVE["layout"])) == sorted(FOXGLOVE["configById"])


@pytest.mark.parametrize("path", PATHS)
def test_a_plotted_path_is_a_number_of_a_message(path: str) -> None:
    topic, *fields = path.removeprefix("/").split(".")
    value = make(TOPICS[topic].type_name)
    for field in fields:
        value = getattr(value, field)
    assert isinstance(value, (int, float))


def test_all_topics_are_ours() -> None:
    panels = FOXGLOVE["configById"].values()
    shown = {name for panel in panels for name in panel.get("topics", {})}
    shown |= {panel[key] for panel in panels for key in ("topicToRender", "topicPath") if key in panel}
    displays = RVIZ["Visualization Manager"]["Displays"]
    shown |= {display["Topic"]["Value"] for display in displays if "Topic" in display}
    assert {name.removeprefix("/") for name in shown} <= TOPICS.keys()
    assert len(PATHS) > 10
