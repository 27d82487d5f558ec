# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Finds the bags that are named, and all bags in the folders that are named."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from trackslip_bags.metadata import METADATA
from trackslip_bags.sources import bag_files
from trackslip_common.errors import InputError


def is_folder(path: Path) -> bool:
    """Whether a path is a directory but no bag, so that it stands for the bags in it.

    Raises:
        InputError: the directory cannot be read.
    """
    try:
        return path.is_dir() and not (path / METADATA).exists() and not bag_files(path)
    except OSError as error:
        _raise_unreadable(error)


def find_bags(paths: Sequence[Path]) -> list[Path]:
    """The bags, each once; those of a folder at any depth, by name. Missing bags are returned as named.

    Raises:
        InputError: a folder has no bag, or a folder in it cannot be read.
    """
    found: dict[Path, None] = {}
    for path in paths:
        bags = _bags_in_folder(path) if is_folder(path) else [path]
        if not bags:
            raise InputError(f"no bag in folder '{path}'; accepted: a bag, or a folder of bags")
        found |= dict.fromkeys(bags)
    return list(found)


def short_names(paths: Sequence[Path]) -> list[str]:
    """Names of bags, without their common folders."""
    common = 0
    while all(len(path.parts) > common + 1 for path in paths) and len({p.parts[common] for p in paths}) == 1:
        common += 1
    return [str(Path(*path.parts[common:])) for path in paths]


def _bags_in_folder(folder: Path) -> list[Path]:
    bags = []
    for name, folders, _ in os.walk(folder, onerror=_raise_unreadable):
        inner = [Path(name) / one for one in sorted(folders)]
        bags += [path for path in inner if not is_folder(path)]
        folders[:] = [path.name for path in inner if is_folder(path)]
    return sorted(bags)


def _raise_unreadable(error: OSError) -> NoReturn:
    place = Path(error.filename or ".")
    folder = place.parent if place.name == METADATA else place
    raise InputError(
        f"folder '{folder}' cannot be read ({error.strerror}); accepted: folders that may be looked into"
    ) from error
