# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Makes hostile files from valid ones: damaged bytes, two joined files, values of other types, YAML bombs."""

import json
import random
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from datetime import date
from typing import Any, TypeAlias

import yaml

Place: TypeAlias = tuple[Any, Any]  # mapping or list, and the key in it

# Texts that are difficult for parsers, inserted anywhere.
TOKENS = (
    *("[" * 5000, "{" * 5000, "]" * 50, "- " * 3000, "? " * 500, "7" * 5000, "'" * 3, '"', "\t", "\0"),
    *("&a [*a]", "&a [*b]", "*a", "<<: *a", "<<: {<<: {}}", "---", "...", "%YAML 9.9", "%TAG ! !!", "\n: \n"),
    *("!!python/object:os.system ls", "!!binary '%%'", "!!set [1]", "!!omap 1", "!!float x", "!!int 1_0_"),
    "!x y",
    *("!!timestamp x", "2026-13-45", "2026-01-01T99:00:00", "190:20:30", "0x", "0b2", "0o8", "1e400"),
    "-1e400",
    *(".nan", "-.inf", "9223372036854775808", "-0", "~", "null", "yes", "''", "a: a: a", "\x1b[2J", "\ufeff"),
    *("\u2028", "\U0001f69c", "é" * 300, "a" * 200_000, "x,", ",,,,", '"x', "=1+1", "nan", "inf", "1,5"),
    "+-1",
)
SWAPS: tuple[Any, ...] = (
    *(None, "", 0, -1, 1, True, 2**62, -(2**63), 1e308, -1e308, 5e-324, float("nan"), float("inf"), 0.5),
    *("x", "nan", "1e3", "\x1b[2J", "a" * 5000, [], {}, [[]], [{}], {"a": {"b": {"c": {}}}}, {1: 2}),
    {None: 1},
    *(date(2026, 1, 1), b"\xff", [1] * 1000, [None], [float("nan")] * 3, {"x": [1, {"y": None}]}),
    *("../../etc", "/dev/zero", "/etc/passwd", "..", "\0", "~", "x.db3", "sqlite3", "zstd", "message"),
)


def hostile(seeds: Sequence[bytes], seed: int) -> bytes:
    """One hostile file per ``seed``; every third has a form that parsers accept."""
    draw = random.Random(seed)
    variants: list[Callable[[random.Random, bytes, bytes], bytes]] = [_damaged, _joined, _swapped]
    made = variants[seed % len(variants)](draw, draw.choice(seeds), draw.choice(seeds))
    return _damaged(draw, made, made) if draw.random() < 0.1 else made


def _damaged(draw: random.Random, content: bytes, _: bytes) -> bytes:
    """Bytes changed, removed, doubled, and tokens inserted."""
    for _time in range(draw.choice((1, 1, 2, 5))):
        at, length = draw.randrange(len(content) + 1), draw.choice((1, 1, 2, 8, 100))
        token = draw.choice(TOKENS).encode()
        content = draw.choice(
            (
                content[:at] + token + content[at:],
                content[:at] + token + content[at + length :],
                content[:at] + content[at + length :],
                content[:at] + content[at : at + length] * 50 + content[at:],
                content[:at] + draw.randbytes(length) + content[at + length :],
                content[:at],
            )
        )
    return content


def _joined(draw: random.Random, one: bytes, other: bytes) -> bytes:
    """The head of one and the tail of another, by lines or anywhere."""
    if draw.random() < 0.5:
        return one[: draw.randrange(len(one) + 1)] + other[draw.randrange(len(other) + 1) :]
    lines = one.splitlines(keepends=True) + other.splitlines(keepends=True)
    return b"".join(draw.sample(lines, draw.randint(1, len(lines))))


def _overwritten(draw: random.Random, content: bytes) -> bytes:
    """Some bytes replaced without moving the others."""
    changed = bytearray(content)
    for _time in range(draw.choice((1, 1, 2, 5))):
        at, length = draw.randrange(len(content)), draw.choice((1, 1, 2, 8))
        values = draw.choice((draw.randbytes(length), bytes(length), b"\xff" * length))
        changed[at : at + length] = values[: len(content) - at]
    return bytes(changed)


def _swapped(draw: random.Random, content: bytes, other: bytes) -> bytes:
    """YAML or lines of JSON with values replaced by others, also by whole branches of another file.

    In binary files bytes are overwritten, because readers find parts by their addresses.
    """
    if b"\0" in content:
        return _overwritten(draw, content)
    lines = content.splitlines()
    if lines and lines[0].startswith(b"{"):
        k = draw.randrange(len(lines))
        try:
            tree = [json.loads(lines[k])]
        except ValueError:
            return _damaged(draw, content, other)
        _swap(draw, tree, tree)
        lines[k] = json.dumps(tree[0], default=str, skipkeys=True).encode()
        return b"\n".join(lines)
    try:
        tree, branches = ([yaml.safe_load(text)] for text in (content, other))
    except yaml.YAMLError:
        return _damaged(draw, content, other)
    for _time in range(draw.choice((1, 1, 1, 3))):
        _swap(draw, tree, branches)
    return str(yaml.safe_dump(tree[0], sort_keys=False)).encode("utf-8", "replace")


def _swap(draw: random.Random, tree: list[Any], other: list[Any]) -> None:
    """Replace or rename one value of the tree."""
    places = list(_places(tree))
    if not places:
        return
    where, key = draw.choice(places)
    branches = [branch[name] for branch, name in _places(other)]
    where[key] = deepcopy(
        draw.choice((draw.choice(SWAPS), draw.choice(SWAPS), draw.choice(branches or SWAPS)))
    )
    if isinstance(where, dict) and draw.random() < 0.2:
        where[draw.choice(("x", 1, None, True, "a.b", *where))] = where.pop(key)


def _places(tree: Any) -> Iterator[Place]:
    """Every value as its container and key."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in list(items):
        yield tree, key
        yield from _places(value)
