# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Changes that a replay applies to the inputs of the estimator: window, names, outages, thinning.

Times are seconds from the bag's first message.
"""

import math
from dataclasses import dataclass, field

from trackslip_common.arrays import BoolArray, FloatArray
from trackslip_common.errors import InputError

_RATES = (1e-6, 1e6)  # Hz; outside, a period is imprecise in whole ns, or longer than any log
_LARGEST_SIGMA = 1e6  # m


@dataclass(frozen=True)
class Withhold:
    """Withholds a topic from the estimator between two times."""

    topic: str
    start_s: float = -math.inf
    stop_s: float = math.inf

    def covers(self, t: FloatArray) -> BoolArray:
        """(n,) whether each time, s, is withheld."""
        return (self.start_s <= t) & (t < self.stop_s)


@dataclass(frozen=True)
class Thin:
    """Reduces a topic to a rate, and adds noise to the positions that remain."""

    topic: str
    rate_hz: float
    sigma: float | None = None  # m


@dataclass(frozen=True)
class InputFilters:
    """All changes of one replay."""

    start_s: float = 0.0
    stop_s: float = math.inf
    remap: dict[str, str] = field(default_factory=dict)
    withhold: tuple[Withhold, ...] = ()
    thin: tuple[Thin, ...] = ()
    seed: int = 0

    @property
    def changes_inputs(self) -> bool:
        """Whether the inputs differ from those of the live estimator."""
        return self != InputFilters(seed=self.seed)

    def is_withheld(self, topic: str, t: float) -> bool:
        """Whether a topic is withheld at a time, s."""
        return any(w.topic == topic and w.start_s <= t < w.stop_s for w in self.withhold)


def parse_withhold(text: str) -> Withhold:
    """The ``Withhold`` of ``TOPIC`` or ``TOPIC:T0:T1``.

    Raises:
        InputError: the text has another form.
    """
    topic, *times = text.split(":")
    if topic and not times:
        return Withhold(relative_name(topic))
    start_s, stop_s = _numbers(text, times, "--withhold", "TOPIC or TOPIC:T0:T1 (s)", 2, 2)
    if not topic or start_s >= stop_s:
        raise InputError(f"--withhold {text}: accepted: TOPIC or TOPIC:T0:T1 with T0 < T1 (s)")
    return Withhold(relative_name(topic), start_s, stop_s)


def parse_thin(text: str) -> Thin:
    """The ``Thin`` of ``TOPIC:HZ`` or ``TOPIC:HZ:SIGMA``.

    Raises:
        InputError: the text has another form.
    """
    topic, *rest = text.split(":")
    rate_hz, *sigma = _numbers(text, rest, "--thin", "TOPIC:HZ or TOPIC:HZ:SIGMA (m)", 1, 2)
    if (
        not topic
        or not _RATES[0] <= rate_hz <= _RATES[1]
        or not all(0.0 < s <= _LARGEST_SIGMA for s in sigma)
    ):
        ranges = f"{_RATES[0]:g} <= HZ <= {_RATES[1]:g} and 0 < SIGMA <= {_LARGEST_SIGMA:g} (m)"
        raise InputError(f"--thin {text}: accepted: TOPIC:HZ[:SIGMA] with {ranges}")
    return Thin(relative_name(topic), rate_hz, sigma[0] if sigma else None)


def parse_remap(text: str) -> tuple[str, str]:
    """Old and new name in ``from:=to``.

    Raises:
        InputError: the text has another form.
    """
    before, sign, after = text.partition(":=")
    if not sign or not before or not after:
        raise InputError(f"--remap {text}: accepted: from:=to")
    return relative_name(before), relative_name(after)


def relative_name(topic: str) -> str:
    """A topic's relative name, as nodes use it."""
    return topic.removeprefix("/")


def _numbers(
    text: str, parts: list[str], option: str, form: str, min_count: int, max_count: int
) -> list[float]:
    try:
        numbers = [float(part) for part in parts]
    except ValueError as error:
        raise InputError(f"{option} {text}: accepted: {form}") from error
    if not min_count <= len(numbers) <= max_count or not all(map(math.isfinite, numbers)):
        raise InputError(f"{option} {text}: accepted: {form}")
    return numbers
