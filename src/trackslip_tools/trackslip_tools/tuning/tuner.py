# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Tunes over many bags, and cross-validates: each bag is left out of a search and scored with its result."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import trackslip_estimation
from trackslip_common.arrays import FloatArray
from trackslip_tools import tuning
from trackslip_tools.result_cache import ResultCache, key_of
from trackslip_tools.tuning.plan import POSE, POSITION, Plan, value_of
from trackslip_tools.tuning.search import search
from trackslip_tools.tuning.task import Job, Score, Task

ScoreJobs = Callable[[Sequence[Job]], Iterator[Score]]
"""Scores of the jobs, in their order."""

_WORST_COST = 1e9  # cost without a score


@dataclass(frozen=True)
class Fold:
    """Result of a search without one bag."""

    bag: int
    values: dict[str, float]
    score: Score  # of the left-out bag


@dataclass(frozen=True)
class Tuning:
    """Result of a tuning."""

    plan: Plan
    bags: list[str]
    values_before: dict[str, float]  # of the first bag
    values: dict[str, float]
    before: list[Score]  # of each bag
    after: list[Score]
    folds: list[Fold]  # empty with one bag or without cross-validation
    mistaken: tuple[str, ...] = ()  # bags whose setup check found a mistake

    @property
    def improves_unseen(self) -> bool:
        """Whether the left-out bags improve on average; without folds, whether all bags do on average."""
        objective = self.plan.settings.objective
        scores = {fold.bag: fold.score for fold in self.folds} or dict(enumerate(self.after))
        changes = [
            cost(objective, score) - cost(objective, self.before[bag]) for bag, score in scores.items()
        ]
        return sum(changes) < 0.0

    @property
    def verdict(self) -> str:
        """What the values are worth, in sentences."""
        bags = "Bags that were left out" if self.folds else "Bags"
        sentences = [f"{bags} are {'' if self.improves_unseen else 'not '}better off on average."]
        if self.improves_unseen and not self.folds:
            sentences.append(
                "No bag was left out: the values may fit these bags alone. Tune on several drives, or replay "
                "another one with --params before they are used."
            )
        if self.mistaken:
            names = ", ".join(self.mistaken)
            sentences.append(
                f"The values fit a mistake of the setup in {names}: correct it (trackslip check)."
            )
        return " ".join(sentences)


class Tuner:
    """Runs searches that share their scores."""

    def __init__(
        self,
        plan: Plan,
        tasks: Sequence[Task],
        work: ScoreJobs,
        journal: ResultCache[Score],
        advance: Callable[[int], None],
    ) -> None:
        """``advance`` gets the number of scored sets (new or from the journal) after each step."""
        self._plan, self._tasks, self._work, self._journal = plan, tasks, work, journal
        self._advance = advance

    def run(self, cross_validate: bool) -> Tuning:
        """Tune over all bags and, with ``cross_validate``, over all but each."""
        all_bags = range(len(self._tasks))
        start = np.mean([self._plan.shares(task.p) for task in self._tasks], axis=0)
        best = self._search(all_bags, start)
        folds = []
        if cross_validate and len(self._tasks) > 1:
            for left_out in all_bags:
                values = self._search([bag for bag in all_bags if bag != left_out], start)
                folds.append(Fold(left_out, values, self._scores([values], [left_out])[0][0]))
        return Tuning(
            self._plan,
            [task.name for task in self._tasks],
            {name: value_of(self._tasks[0].p, name) for name in self._plan.bounds},
            best,
            [task.score({}) for task in self._tasks],
            self._scores([best], all_bags)[0],
            folds,
        )

    def _search(self, bags: Sequence[int], start: FloatArray) -> dict[str, float]:
        settings = self._plan.settings

        def costs(points: FloatArray) -> FloatArray:
            rows = self._scores([self._plan.values(point) for point in points], bags)
            self._advance(len(rows))
            return np.array([np.mean([cost(settings.objective, score) for score in row]) for row in rows])

        return self._plan.values(search(costs, start, settings.evaluations, settings.seed))

    def _scores(self, sets: Sequence[dict[str, float]], bags: Sequence[int]) -> list[list[Score]]:
        """Scores of each set and bag; those in the journal are not computed again."""
        keys = [[self._key(bag, values) for bag in bags] for values in sets]
        requested = {
            key: (bag, values)
            for row, values in zip(keys, sets, strict=True)
            for key, bag in zip(row, bags, strict=True)
        }
        missing = {key: job for key, job in requested.items() if key not in self._journal}
        for key, score in zip(missing, self._work(list(missing.values())), strict=True):
            self._journal.add(key, score)
        return [[self._journal[key] for key in row] for row in keys]

    def _key(self, bag: int, values: Mapping[str, float]) -> str:
        parts = {"task": self._tasks[bag].fingerprint, "values": values}
        return key_of(parts, trackslip_estimation, tuning)


def cost(objective: str, score: Score) -> float:
    """The cost to minimise: minus a mean ln likelihood, or ln of the position error (m)."""
    if objective == POSITION:
        value = math.log(max(score.position, 1e-9))
    else:
        value = -(score.pose_log_likelihood if objective == POSE else score.log_likelihood)
    return value if math.isfinite(value) else _WORST_COST
