# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip replay --publish``: plays a bag into a live graph."""

import argparse
import os
import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.playback import Playback, played_messages, played_topics
from trackslip_bags.reader import Bag, require_topics
from trackslip_common.errors import InputError, show, suggestion
from trackslip_tools.cli.nodes import load_node_module, shorten_logs

_RATE_LIMITS = (0.01, 100.0)
# Options rejected together with --publish.
_OFFLINE_OPTIONS = ("params", "set", "vehicle", "thin", "reference", "output", "json")
_LIVE_OPTIONS = ("rate", "paused", "loop", "also")  # options accepted only together with --publish


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare ``--publish`` and its options."""
    group = parser.add_argument_group("driving a live graph (needs ROS)")
    add = group.add_argument
    add("--publish", action="store_true", help="publish the bag and /clock instead; the space bar pauses")
    add("--rate", metavar="R", type=parse_rate, help="times real time (default: 1)")
    add("--paused", action="store_true", help="begin paused: the space bar or /replay/pause starts it")
    add("--loop", action="store_true", help="begin again at the end")
    add(
        "--also",
        metavar="TOPIC",
        action="append",
        default=[],
        help="publish what the estimators make, too, such as odometry",
    )


def refuse_without_publish(args: argparse.Namespace) -> None:
    """Reject options that need a live graph.

    Raises:
        InputError: one of them is given.
    """
    _refuse_options(args, _LIVE_OPTIONS, "only together with --publish")


def publish(bag: Bag, filters: InputFilters, args: argparse.Namespace) -> int:
    """Play the bag; returns the exit code.

    Raises:
        InputError: an option or a topic cannot be used, or ROS is not available.
    """
    _refuse_options(args, _OFFLINE_OPTIONS, "not together with --publish")
    require_topics(bag, [*filters.remap, *args.also])
    shorten_logs()
    player = load_node_module("trackslip_bags.nodes.player", "--publish")
    topics = played_topics(bag, filters, args.also)
    for topic in [topic for topic, kind in topics.items() if not player.can_publish(kind)]:
        show(f"note: {topic} is left out, {topics.pop(topic)} is not installed", file=sys.stderr)
    for edit in filters.withhold:
        if f"/{edit.topic}" not in topics:
            hint = suggestion(f"/{edit.topic}", sorted(topics))
            raise InputError(f"--withhold {edit.topic}: there is no such topic{hint}")
    playback = Playback(
        partial(played_messages, bag, filters, topics), args.rate or 1.0, args.paused, args.loop
    )
    if playback.is_finished:
        raise InputError(f"bag '{bag.path}': nothing to publish between --start and --stop")
    with Keyboard() as keyboard, _playback_bar(bag) as progress:
        code: int = player.play(playback, topics, keyboard.read_keys, progress)
    show(f"{sum(playback.counts.values())} messages published")
    for topic, count in sorted(playback.counts.items()):
        show(f"  {topic:<24}{count:>8}")
    return code


def parse_rate(text: str) -> float:
    """Parse a multiple of real time."""
    with suppress(ValueError):
        if _RATE_LIMITS[0] <= float(text) <= _RATE_LIMITS[1]:
            return float(text)
    raise argparse.ArgumentTypeError(
        f"'{text}' is refused; accepted: {_RATE_LIMITS[0]:g} to {_RATE_LIMITS[1]:g}"
    )


def _refuse_options(args: argparse.Namespace, names: tuple[str, ...], why: str) -> None:
    refused = [f"--{name}" for name in names if getattr(args, name)]
    if refused:
        raise InputError(f"{', '.join(refused)}: accepted {why}")


@contextmanager
def _playback_bar(bag: Bag) -> Iterator[Callable[[Playback], None]]:
    """Context of a function that shows the playback's position: a bar on a terminal, nothing in a pipe."""
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    position = TextColumn("{task.completed:.1f} s of the bag")
    columns = (TextColumn("{task.description}"), BarColumn(), position, TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("playing", total=bag.duration_s)

        def update(playback: Playback) -> None:
            reached = (playback.bag_ns - bag.start_ns) * 1e-9
            bar.update(task, completed=reached, description="paused " if playback.paused else "playing")

        yield update


class Keyboard:
    """Reads single keys while it is open; nothing in a pipe or in the background."""

    def __init__(self) -> None:
        self._saved: list[Any] | None = None

    def __enter__(self) -> "Keyboard":
        if sys.stdin.isatty() and _is_foreground(sys.stdin.fileno()):
            self._saved = termios.tcgetattr(sys.stdin.fileno())
            tty.setcbreak(sys.stdin.fileno())
        return self

    def __exit__(self, *raised: object) -> None:
        if self._saved is not None:
            termios.tcsetattr(sys.stdin.fileno(), termios.TCSADRAIN, self._saved)
            self._saved = None

    def read_keys(self) -> str:
        """The keys typed since the last call."""
        text = ""
        while self._saved is not None and select.select([sys.stdin], [], [], 0.0)[0]:
            key = os.read(sys.stdin.fileno(), 64)
            if not key:  # terminal closed
                break
            text += key.decode(errors="replace")
        return text


def _is_foreground(terminal: int) -> bool:
    """Whether this is the foreground job; a background job is stopped when it changes terminal settings."""
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:  # terminal of another session
        return False
