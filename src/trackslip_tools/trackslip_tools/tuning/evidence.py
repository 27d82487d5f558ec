# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What a tuning leaves behind: a parameter file that the nodes load, and beside it what it rests on."""

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from trackslip_common.config_files import nested
from trackslip_common.errors import InputError
from trackslip_common.parameters import to_flat
from trackslip_common.whole_file import write_whole
from trackslip_estimation.slip.parameters import NODE, SlipEstimatorParameters
from trackslip_tools.tuning.plan import changed, expanded
from trackslip_tools.tuning.task import Score
from trackslip_tools.tuning.tuner import Tuning

PARAMETERS, TABLE, NUMBERS, JOURNAL = "slip_estimator.yaml", "evidence.md", "evidence.json", "journal.jsonl"

# How each begins; by that a later tuning knows what it may replace.
BEGINNINGS = {
    PARAMETERS: "# Found by trackslip tune",
    TABLE: f"# What {PARAMETERS} rests on",
    NUMBERS: "{",
}


def write_evidence(folder: Path, tuning: Tuning, p: SlipEstimatorParameters) -> None:
    """Parameters and table; ``p`` is what tuning started from.

    Raises:
        InputError: the folder cannot be written.
    """
    values = to_flat(changed(p, tuning.values))
    found = {full: values[full] for tuned in tuning.values for full in expanded(p, tuned)}
    text = f"{BEGINNINGS[PARAMETERS]} on {', '.join(tuning.bags)}; what it rests on is in {TABLE}.\n"
    text += yaml.safe_dump({NODE: {"ros__parameters": nested(found)}}, sort_keys=False)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / PARAMETERS, text)
        write_whole(folder / TABLE, f"{BEGINNINGS[TABLE]}\n\n{table(tuning)}\n")
    except OSError as error:
        raise InputError(f"--output: '{folder}' cannot be written ({error.strerror})") from error


def numbers(tuning: Tuning) -> dict[str, Any]:
    """For programs."""
    return {
        "objective": tuning.plan.settings.objective,
        "values": {"before": tuning.values_before, "after": tuning.values},
        "bags": [
            {"bag": bag, "before": before._asdict(), "after": after._asdict()}
            for bag, before, after in zip(tuning.bags, tuning.before, tuning.after, strict=True)
        ],
        "left_out": [
            {"bag": tuning.bags[fold.bag], "values": fold.values, "score": fold.score._asdict()}
            for fold in tuning.folds
        ],
        "improves_unseen": tuning.improves_unseen,
    }


def table(tuning: Tuning) -> str:
    """Markdown: the values, then each bag before and after, and as it is where it had no say."""
    ranges = {
        name: [fold.values[name] for fold in tuning.folds] or [value] for name, value in tuning.values.items()
    }
    values = [
        [
            name,
            f"{tuning.values_before[name]:.4g}",
            f"{value:.4g}",
            f"{min(ranges[name]):.4g} to {max(ranges[name]):.4g}" if tuning.folds else "",
        ]
        for name, value in tuning.values.items()
    ]
    sources = sorted({source for score in tuning.before for source in score.nis})
    rows = []
    unseen = {fold.bag: fold.score for fold in tuning.folds}
    for bag, name in enumerate(_short(tuning.bags)):
        stages = (("before", tuning.before[bag]), ("after", tuning.after[bag]), ("unseen", unseen.get(bag)))
        rows += [[name, stage, *_cells(score, sources)] for stage, score in stages if score is not None]
    heading = ["bag", "", "ln likelihood", *(f"NIS {source}" for source in sources), "refused"]
    heading += ["position m", "heading rad", "NEES", "ln pose"]
    notes = (
        "ln likelihood: mean of a measurement; ln pose: of a pose of the reference. NIS: mean of a source's "
        "normalised innovation squared over its degrees of freedom, 1 if consistent; NEES: of the pose's "
        "against the reference, 3 if consistent."
    )
    if tuning.folds:
        notes += " Unseen: with the values found on the other bags alone, whose range the first table gives."
        worse = "" if tuning.improves_unseen else "not "
        notes += f"\n\nBags that had no say are {worse}better off on average."
    parts = (
        _aligned(["parameter", "before", "after", "without one bag"], values, 1),
        _aligned(heading, rows, 2),
        notes,
    )
    return "\n\n".join(parts)


def _short(bags: Sequence[str]) -> list[str]:
    """Names of bags, without the folders that all of them are in."""
    if len(bags) == 1:
        return [Path(bags[0]).name]
    paths = [Path(bag).resolve() for bag in bags]
    common = os.path.commonpath(paths)
    return [str(path.relative_to(common)) for path in paths]


def _cells(score: Score, sources: Sequence[str]) -> list[str]:
    nis = [_number(score.nis.get(source, math.nan), ".2f") for source in sources]
    errors = (_number(score.position, ".4f"), _number(score.heading, ".4f"), _number(score.nees, ".2f"))
    pose = _number(score.pose_log_likelihood, ".2f")
    return [f"{score.log_likelihood:.3f}", *nis, str(sum(score.rejected.values())), *errors, pose]


def _number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else ""


def _aligned(heading: Sequence[str], rows: Sequence[Sequence[str]], keys: int) -> str:
    """A Markdown table that is also one to the eye; ``keys`` columns stand left, numbers right."""
    columns = list(zip(heading, *rows, strict=True))
    cells = [_padded(column, max(map(len, column)), is_key=k < keys) for k, column in enumerate(columns)]
    return "\n".join(f"| {' | '.join(line)} |" for line in zip(*cells, strict=True))


def _padded(column: Sequence[str], width: int, *, is_key: bool) -> list[str]:
    rule = "-" * width if is_key else "-" * (width - 1) + ":"
    heading, *cells = (cell.ljust(width) if is_key else cell.rjust(width) for cell in column)
    return [heading, rule, *cells]
