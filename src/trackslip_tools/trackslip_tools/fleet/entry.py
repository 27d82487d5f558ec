# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The result of one bag of many, which a worker returns: numbers and texts, no arrays."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from trackslip_common.errors import ExitCode, InputError, collect_output
from trackslip_common.vehicle_files import DEFAULT_VEHICLE_NOTE
from trackslip_tools.replay.output import summary
from trackslip_tools.replay.result import Replay

_TIMING = "real_time_factor"  # depends on the load of the machine


@dataclass(frozen=True)
class Entry:
    """Result of one bag."""

    bag: str
    exit_code: int
    error: str = ""  # error line, as of the command on this bag alone
    notes: tuple[str, ...] = ()  # further lines of output
    distance: float | None = None  # m, distance travelled
    summary: dict[str, Any] = field(default_factory=dict)  # contents of ``replay --json``
    page: str = ""  # HTML, of a report

    @property
    def vehicle(self) -> str:
        """Name of the vehicle, marked if assumed; empty if the bag could not be read."""
        name = self.summary.get("vehicle", "")
        is_assumed = any(note.startswith(DEFAULT_VEHICLE_NOTE) for note in self.notes)
        return f"{name} (assumed)" if is_assumed else name

    def as_dict(self) -> dict[str, Any]:
        """The entry of ``--json``."""
        head = {"bag": self.bag, "exit_code": self.exit_code, "error": self.error, "notes": [*self.notes]}
        return {**head, "distance": self.distance, **self.summary}


def entry_of(path: Path, replay_bag: Callable[[], tuple[Replay, str]], *, force: bool) -> Entry:
    """Result of a bag, with any error in it; ``replay_bag`` returns the replay and the page.

    ``force``: accept a wrong setup.
    """
    with collect_output() as lines:
        try:
            result, page = replay_bag()
        except (InputError, OSError) as error:
            text = str(error) if isinstance(error, InputError) else f"bag '{path}': {error.strerror}"
            return Entry(str(path), ExitCode.BAD_INPUT, text, tuple(lines))
    content = summary(result, result.elapsed_s or 1.0)
    del content[_TIMING]
    code = ExitCode.FAILED if result.has_failed(force=force) else ExitCode.DONE
    setup_error = "" if result.setup.is_plausible else f"setup: {result.setup.headline}"
    failure = result.no_estimate or setup_error
    return Entry(str(path), code, failure, tuple(lines), result.travel.distance, content, page)


def exit_code(entries: Iterable[Entry]) -> int:
    """The worst exit code: bad input if a bag was not read, failed without estimate or plausible setup."""
    return max(entry.exit_code for entry in entries)
