# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Hostile files and texts."""

import os
from pathlib import Path

import pytest

from trackslip_common.config_files import read_yaml
from trackslip_common.errors import InputError, show


def test_named_pipe_as_yaml_is_refused_without_blocking(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yaml")
    with pytest.raises(InputError, match="no regular file"):
        read_yaml(tmp_path / "pipe.yaml")


def test_shown_text_has_no_control_characters(capsys: pytest.CaptureFixture[str]) -> None:
    show("a\x1b[2J\nb\x07", 3)
    assert capsys.readouterr().out == "a\\x1b[2J\nb\\x07\n3\n"
