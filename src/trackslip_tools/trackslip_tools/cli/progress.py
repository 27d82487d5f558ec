# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A progress bar with the remaining time on a terminal; nothing, and no import of rich, in a pipe."""

import sys
from collections.abc import Callable, Iterable, Iterator, Sized
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeVar

from trackslip_common.compiling import show_in_place

if TYPE_CHECKING:
    from trackslip_bags.reader import Bag
    from trackslip_tools.replay.parts import Part

T = TypeVar("T")

_label_setters: list[Callable[[str], None]] = []  # label setters of the open bars, the innermost last


def iterate_with_bar(items: Iterable[T], label: str, total: int | None = None) -> Iterator[T]:
    """Yield the items and show a bar on stderr; ``total`` for items without a length."""
    count = len(items) if total is None and isinstance(items, Sized) else total
    with progress_bar(count, label) as advance:
        for item in items:
            yield item
            advance(1)


@contextmanager
def progress_bar(total: float | None, label: str) -> Iterator[Callable[[float], None]]:
    """Context of a bar on stderr; the yielded function advances the bar.

    ``total`` None: unknown; the bar only shows activity.
    """
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = [TextColumn("{task.description}"), BarColumn()]
    columns += [] if total is None else [TaskProgressColumn(), TimeRemainingColumn()]
    with Progress(*columns, console=Console(file=sys.stderr), transient=True) as bar:
        task = bar.add_task(label, total=total)
        _label_setters.append(lambda text: bar.update(task, description=text or label))
        try:
            yield lambda done: bar.advance(task, done)
        finally:
            _label_setters.pop()


def show_status(text: str) -> None:
    """Replace the bar's label, or the cursor's line on a terminal; an empty text restores it."""
    (_label_setters[-1] if _label_setters else show_in_place)(text)


def scale_progress(advance: Callable[[float], None], whole: float) -> Callable[[float], None]:
    """Advances a bar of items by parts of one item, which sum to ``whole``."""
    return lambda part: advance(part / (whole or 1.0))


def replay_progress(bag: "Bag", advance: Callable[[float], None]) -> Callable[["Part"], None]:
    """Watch of a replay that advances a bar of seconds."""
    reached_ns = bag.start_ns

    def watch(part: "Part") -> None:
        nonlocal reached_ns
        if len(part.arrivals):
            newest_ns = int(part.arrivals["log_time_ns"].max())
            advance(max(newest_ns - reached_ns, 0) * 1e-9)
            reached_ns = max(newest_ns, reached_ns)

    return watch
