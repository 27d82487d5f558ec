# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Files are written beside their place: complete or not at all, never through a link at that place."""

import errno
import os
import secrets
from pathlib import Path

import pytest

from trackslip_common.atomic_files import (
    UNFINISHED_NAME,
    atomic_replacement,
    replace_atomically,
    write_atomically,
)

VICTIM = "of another user\n"


@pytest.fixture
def victim(tmp_path: Path) -> Path:
    path = tmp_path / "victim"
    path.write_text(VICTIM, encoding="utf-8")
    return path


@pytest.fixture
def page(tmp_path: Path) -> Path:
    """A path in a folder of its own."""
    (tmp_path / "folder").mkdir()
    return tmp_path / "folder" / "page"


def test_link_planted_beside_a_file_is_not_followed(page: Path, victim: Path) -> None:
    planted = page.with_name(".page.new")
    planted.symlink_to(victim)
    write_atomically(page, "mine")
    assert page.read_text(encoding="utf-8") == "mine"
    assert victim.read_text(encoding="utf-8") == VICTIM
    assert planted.is_symlink()


@pytest.mark.parametrize("plant", ["link", "dangling link", "file"])
def test_existing_temporary_file_is_not_written_to(
    page: Path, victim: Path, monkeypatch: pytest.MonkeyPatch, plant: str
) -> None:
    monkeypatch.setattr(secrets, "token_hex", lambda count: "0" * 2 * count)
    planted = page.with_name(".trackslip-0000000000000000.new")
    assert UNFINISHED_NAME.fullmatch(planted.name)
    if plant == "file":
        planted.write_text(VICTIM, encoding="utf-8")
    else:
        planted.symlink_to(victim if plant == "link" else page.with_name("nothing"))
    with pytest.raises(FileExistsError):
        write_atomically(page, "mine")
    assert victim.read_text(encoding="utf-8") == VICTIM
    assert [path.name for path in page.parent.iterdir()] == [planted.name]


def test_failure_before_the_move_keeps_the_old_file(page: Path) -> None:
    write_atomically(page, "before")
    with pytest.raises(KeyboardInterrupt), atomic_replacement(page, "after"):
        raise KeyboardInterrupt
    assert [(path.name, path.read_text()) for path in page.parent.iterdir()] == [("page", "before")]


def test_full_disk_keeps_the_old_file(page: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    write_atomically(page, "before")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"), atomic_replacement(page, "after that", sync=True):
        pytest.fail("it is not written yet")
    assert [(path.name, path.read_text()) for path in page.parent.iterdir()] == [("page", "before")]


def test_link_is_replaced_and_its_target_kept(page: Path, victim: Path) -> None:
    page.symlink_to(victim)
    replace_atomically(page, "mine")
    assert not page.is_symlink()
    assert victim.read_text(encoding="utf-8") == VICTIM


def test_permissions_are_those_of_any_new_file(page: Path) -> None:
    before = os.umask(0o027)
    try:
        replace_atomically(page, b"mine")
    finally:
        os.umask(before)
    assert page.stat().st_mode & 0o777 == 0o640
