# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A fuzzer's input as a script: pieces of a kind, so that it can build what no random bytes would hit."""

from collections.abc import Iterator

KINDS = 8


def pieces(data: bytes) -> Iterator[tuple[int, bytes]]:
    """(kind below ``KINDS``, bytes): behind a header byte of kind (3 bits) and length class, its content."""
    at = 0
    while at < len(data):
        kind, size_class = data[at] & (KINDS - 1), data[at] >> 3
        size = size_class if size_class < 24 else (size_class - 23) * 96  # 0 … 23, 96 … 768
        yield kind, data[at + 1 : at + 1 + size]
        at += 1 + size


def script(*parts: tuple[int, bytes]) -> bytes:
    """The input that gives these pieces; contents longer than a size class are padded with zeros."""
    text = bytearray()
    for kind, content in parts:
        size = len(content) if len(content) < 24 else -(-len(content) // 96) * 96
        size_class = size if size < 24 else 23 + size // 96
        text += bytes((kind | size_class << 3,)) + content.ljust(size, b"\0")
    return bytes(text)
