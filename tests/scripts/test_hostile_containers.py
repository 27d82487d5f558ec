# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The hostile bags of ``make fuzz`` can be made."""

from pathlib import Path

import pytest

from hostile_containers import records

SMALL = [(name, made) for name, made in records() if "MB" not in name and "0000" not in name]


@pytest.mark.parametrize(("name", "made"), SMALL, ids=[name for name, _ in SMALL])
def test_hostile_file_is_written(name: str, made, tmp_path: Path) -> None:
    assert made(tmp_path).stat().st_size > 0, name
