# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Findings of the setup check: causes with evidence, odds and remedy; questions that the log leaves open."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, TypeAlias

LEAST_ODDS = 100.0  # to 1, below which no cause is reported
LEAST_LOG = math.log(LEAST_ODDS)
PRIOR = math.log(300.0)  # ln odds against each mistake
MOST_ODDS = 1e9  # largest odds in a sentence
READ_OFF = 1e5  # odds of a cause that is read off the log, without a likelihood


@dataclass(frozen=True)
class Cause:
    """A mistake of the setup."""

    cause: str  # JSON name
    source: str  # topic
    evidence: str  # one sentence with its numbers
    odds: float  # to 1
    remedy: str  # what to change: key and new value

    @property
    def sentence(self) -> str:
        """Evidence, odds and remedy on one line."""
        return f"{self.cause} ({self.source}): {self.evidence}; odds {odds_text(self.odds)}. {self.remedy}"

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        odds = float(min(self.odds, MOST_ODDS))
        return {
            "cause": self.cause,
            "source": self.source,
            "evidence": self.evidence,
            "odds": round(odds, 1),
            "remedy": self.remedy,
        }


@dataclass(frozen=True)
class OpenQuestion:
    """A question that the log cannot decide, and the motion that would decide it."""

    what: str
    needed: str
    is_wrong: bool = False  # there is a mistake, but the log does not show which of several

    def as_dict(self) -> dict[str, str]:
        """For JSON."""
        return {"what": self.what, "needed": self.needed}


@dataclass(frozen=True)
class MeasuredValue:
    """A quantity of the machine, measured from the drive."""

    name: str  # lever_arm_x, lever_arm_y, yaw_offset, delay
    source: str
    value: float
    half_width: float  # of the 95 % interval
    unit: str
    basis: str


Finding: TypeAlias = Cause | OpenQuestion | MeasuredValue


@dataclass
class Findings:
    """Findings of the steps so far, by kind."""

    causes: list[Cause] = field(default_factory=list)
    undetermined: list[OpenQuestion] = field(default_factory=list)
    measured: list[MeasuredValue] = field(default_factory=list)

    def add(self, found: Iterable[Finding]) -> None:
        """Append each finding to those of its kind."""
        for one in found:
            if isinstance(one, Cause):
                self.causes.append(one)
            elif isinstance(one, OpenQuestion):
                self.undetermined.append(one)
            else:
                self.measured.append(one)

    def has_cause(self, name: str) -> bool:
        """Whether a cause of this name was found."""
        return any(cause.cause == name for cause in self.causes)

    def withdraw(self, name: str) -> None:
        """Drop the causes of this name: a later step explains them better."""
        self.causes = [cause for cause in self.causes if cause.cause != name]


@dataclass(frozen=True)
class Result:
    """Result of one check."""

    causes: tuple[Cause, ...] = ()
    undetermined: tuple[OpenQuestion, ...] = ()
    facts: tuple[str, ...] = ()  # distance and turn by each odometer, rates: one line each
    measured: tuple[MeasuredValue, ...] = ()
    notes: tuple[str, ...] = ()  # on the recording, for every command: one line each

    @property
    def is_plausible(self) -> bool:
        """Whether there is neither a cause nor a certain mistake."""
        return not self.causes and not self.open_questions

    @property
    def open_questions(self) -> tuple[OpenQuestion, ...]:
        """Certain mistakes whose cause is one of several."""
        return tuple(question for question in self.undetermined if question.is_wrong)

    @property
    def headline(self) -> str:
        """One sentence for the first line of a command's output."""
        if not self.causes:
            return (
                "; ".join(f"{question.what}: {question.needed}" for question in self.open_questions)
                or "setup plausible"
            )
        return "; ".join(f"{c.cause}: {c.evidence}" for c in self.causes)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "plausible": self.is_plausible,
            "causes": [cause.as_dict() for cause in self.causes],
            "undetermined": [question.as_dict() for question in self.undetermined],
            "notes": list(self.notes),
        }


def odds_text(odds: float) -> str:
    """Odds as text, as ``2000 : 1``."""
    if odds >= MOST_ODDS or not math.isfinite(odds):
        return "> 1e9 : 1"
    return f"{odds:.0f} : 1" if odds < 1e5 else f"{odds:.0e} : 1"


def odds_of(log_ratio: float) -> float:
    """Odds of a natural log-likelihood ratio, at most ``MOST_ODDS``."""
    return math.exp(min(max(log_ratio, -50.0), math.log(MOST_ODDS)))
