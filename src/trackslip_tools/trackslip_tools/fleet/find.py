# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Which bags are meant: those that are named, and all in the folders that are named."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from trackslip_bags.metadata import METADATA
from trackslip_bags.sources import bag_files
from trackslip_common.errors import InputError


def is_folder(path: Path) -> bool:
    """Whether it is a directory that is no bag itself, so that the bags in it are meant.

    Raises:
        InputError: it may not be looked into.
    """
    try:
        return path.is_dir() and not (path / METADATA).exists() and not bag_files(path)
    except OSError as error:
        _refuse(error)


def find_bags(paths: Sequence[Path]) -> list[Path]:
    """The bags, each once; those of a folder, at any depth, by name. What is not there is named all the same.

    Raises:
        InputError: there is no bag in a folder, or a folder in it may not be looked into.
    """
    found: dict[Path, None] = {}
    for path in paths:
        bags = _inside(path) if is_folder(path) else [path]
        if not bags:
            raise InputError(f"no bag in folder '{path}'; accepted: a bag, or a folder of bags")
        found |= dict.fromkeys(bags)
    return list(found)


def short_names(paths: Sequence[Path]) -> list[str]:
    """Of bags, without the folders that all are in."""
    common = 0
    while all(len(path.parts) > common + 1 for path in paths) and len({p.parts[common] for p in paths}) == 1:
        common += 1
    return [str(Path(*path.parts[common:])) for path in paths]


def _inside(folder: Path) -> list[Path]:
    bags = []
    for name, folders, _ in os.walk(folder, onerror=_refuse):
        inner = [Path(name) / one for one in sorted(folders)]
        bags += [path for path in inner if not is_folder(path)]
        folders[:] = [path.name for path in inner if is_folder(path)]
    return sorted(bags)


def _refuse(error: OSError) -> NoReturn:
    place = Path(error.filename or ".")
    folder = place.parent if place.name == METADATA else place
    raise InputError(
        f"folder '{folder}' cannot be read ({error.strerror}); accepted: folders that may be looked into"
    ) from error
