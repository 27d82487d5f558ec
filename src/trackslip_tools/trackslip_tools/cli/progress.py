# SPDX-License-Identifier: Apache-2.0
"""A progress bar on a terminal; nothing in a pipe."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from rich.console import Console
from rich.progress import Progress, track

T = TypeVar("T")


def shown(items: Iterable[T], label: str, total: int | None = None) -> Iterable[T]:
    """The items, with a bar on stderr that follows them; ``total`` where they have no length."""
    console = Console(stderr=True)
    return track(items, label, total, console=console, transient=True, disable=not console.is_terminal)


@contextmanager
def counted(total: int, label: str) -> Iterator[Callable[[int], None]]:
    """A bar on stderr, moved on by calling what is yielded with how much more is done."""
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(label, total=total)
        yield lambda done: bar.advance(task, done)
