# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A progress bar with the remaining time on a terminal; nothing in a pipe, for which no library is loaded."""

import sys
from collections.abc import Callable, Iterable, Iterator, Sized
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeVar

from trackslip_common.compiling import show_in_place

if TYPE_CHECKING:
    from trackslip_bags.reader import Bag
    from trackslip_tools.replay.parts import Part

T = TypeVar("T")

_relabel: list[Callable[[str], None]] = []  # of the bars that are shown, the last one before all


def shown(items: Iterable[T], label: str, total: int | None = None) -> Iterator[T]:
    """The items, with a bar on stderr that follows them; ``total`` where they have no length."""
    whole = len(items) if total is None and isinstance(items, Sized) else total
    with counted(whole, label) as advance:
        for item in items:
            yield item
            advance(1)


@contextmanager
def counted(total: float | None, label: str) -> Iterator[Callable[[float], None]]:
    """A bar on stderr, moved on by calling what is yielded with how much more is done.

    ``total`` None: nobody knows how much there is; the bar shows that something is done.
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
        _relabel.append(lambda text: bar.update(task, description=text or label))
        try:
            yield lambda done: bar.advance(task, done)
        finally:
            _relabel.pop()


def show_status(text: str) -> None:
    """For now in place of the bar's label, or on the cursor's line of a terminal; empty: no more."""
    (_relabel[-1] if _relabel else show_in_place)(text)


def in_shares(advance: Callable[[float], None], whole: float) -> Callable[[float], None]:
    """Moves a bar that counts pieces of work on by parts of one of them, which together are ``whole``."""
    return lambda part: advance(part / (whole or 1.0))


def following(bag: "Bag", advance: Callable[[float], None]) -> Callable[["Part"], None]:
    """Moves a bar of seconds on by the parts of a replay that it watches."""
    reached_ns = bag.start_ns

    def watch(part: "Part") -> None:
        nonlocal reached_ns
        if len(part.arrivals):
            newest_ns = int(part.arrivals["log_time_ns"].max())
            advance(max(newest_ns - reached_ns, 0) * 1e-9)
            reached_ns = max(newest_ns, reached_ns)

    return watch
