# SPDX-License-Identifier: Apache-2.0
"""A progress bar on a terminal; nothing in a pipe, for which no library is loaded either."""

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

T = TypeVar("T")


def shown(items: Iterable[T], label: str, total: int | None = None) -> Iterable[T]:
    """The items, with a bar on stderr that follows them; ``total`` where they have no length."""
    if not sys.stderr.isatty():
        return items
    from rich.console import Console
    from rich.progress import track

    return track(items, label, total, console=Console(stderr=True), transient=True)


@contextmanager
def counted(total: int, label: str) -> Iterator[Callable[[int], None]]:
    """A bar on stderr, moved on by calling what is yielded with how much more is done."""
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(label, total=total)
        yield lambda done: bar.advance(task, done)
