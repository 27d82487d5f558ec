# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Installed ROS definitions of message types, for a recorder: text for MCAP, and hash.

``share/<package>/msg/<Name>.msg`` and ``.json`` are searched on ``AMENT_PREFIX_PATH``, the text also in the
checkout.
"""

import json
import os
import re
from pathlib import Path

from trackslip_bags.metadata import ROS2MSG, Schema

DEFAULT_DISTRO = "jazzy"

_TYPE_NAME = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Za-z][A-Za-z0-9_]*")
_LINE = re.compile(r"([A-Za-z][\w/]*)(\S*)\s+(\w+)\s*(=?)\s*(.*)")  # type, array, name, =, value or default
_BASIC = re.compile(r"bool|byte|char|float(32|64)|u?int(8|16|32|64)|w?string")
_SEPARATOR = "=" * 80


def ros_distro() -> str:
    """The ROS distribution whose messages are in use: the sourced one, or ``DEFAULT_DISTRO``."""
    return os.environ.get("ROS_DISTRO") or DEFAULT_DISTRO


def msg_file(type_name: str, suffix: str = ".msg") -> Path | None:
    """Path of the type's definition; None if not found."""
    if not _TYPE_NAME.fullmatch(type_name):
        return None
    package, _, name = type_name.split("/")
    prefixes = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), str(Path(__file__).parent)]
    installed = [Path(prefix) / "share" / package for prefix in prefixes if prefix]  # last: the wheel
    checkout = [parent / "src" / package for parent in Path(__file__).resolve().parents]
    candidates = (directory / "msg" / f"{name}{suffix}" for directory in installed + checkout)
    return next((path for path in candidates if path.is_file()), None)


def installed_schema(type_name: str) -> Schema | None:
    """Definition of the type and its inner types; None if a definition or the hash is not installed."""
    description = msg_file(type_name, ".json")
    texts: dict[str, str] = {}
    try:
        _collect_definitions(type_name, texts)
        entries = json.loads(description.read_text(encoding="utf-8"))["type_hashes"] if description else []
        hashes = {str(entry["type_name"]): str(entry["hash_string"]) for entry in entries}
        first, *inner = texts.items()
        parts = [first[1], *(f"{_SEPARATOR}\nMSG: {n.replace('/msg/', '/')}\n{text}" for n, text in inner)]
        return Schema(ROS2MSG, "".join(parts).encode(), hashes[type_name])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _collect_definitions(type_name: str, texts: dict[str, str]) -> None:
    """Add the definitions of a type, then of its inner types in the order of its fields, to the texts.

    The form is that of rosbags: no comments and defaults, full type names, constants first.
    """
    path = msg_file(type_name)
    if path is None:
        raise KeyError(type_name)
    constants, fields, inner = [], [], []
    for line in path.read_text(encoding="utf-8").splitlines():
        content = line.partition("#")[0].strip()
        match = _LINE.fullmatch(content)
        if content and match is None:
            raise ValueError(f"{path}: {content}")
        if match is not None:
            kind, array, name, equals, value = match.groups()
            if not _BASIC.fullmatch(kind):
                kind = _full_name(kind, type_name.partition("/")[0])
                inner.append(kind)
            if equals:
                constants.append(f"{kind} {name}={value}\n")
            else:
                fields.append(f"{kind.replace('/msg/', '/')}{array} {name}\n")
    texts[type_name] = "".join(constants + fields)
    for kind in inner:
        if kind not in texts:
            _collect_definitions(kind, texts)


def _full_name(kind: str, package: str) -> str:
    """``Header`` and ``std_msgs/Header`` in a message of ``package`` → ``std_msgs/msg/Header``."""
    if "/" not in kind:
        return f"std_msgs/msg/{kind}" if kind == "Header" else f"{package}/msg/{kind}"
    return kind if "/msg/" in kind else kind.replace("/", "/msg/")
