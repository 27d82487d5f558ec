# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Results of a tuning: a parameter file for the nodes, and the evidence for its values."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from trackslip_common.config_files import unflatten
from trackslip_common.errors import printable
from trackslip_common.parameters import to_flat
from trackslip_estimation.slip.parameters import NODE, SlipEstimatorParameters
from trackslip_tools.cli.outputs import make_folder, write_file
from trackslip_tools.fleet.find import short_names
from trackslip_tools.terminal_text import markdown_table
from trackslip_tools.tuning.plan import change_parameters, matching_names
from trackslip_tools.tuning.task import Score
from trackslip_tools.tuning.tuner import Tuning

PARAMETERS, TABLE, NUMBERS, JOURNAL = "slip_estimator.yaml", "evidence.md", "evidence.json", "journal.jsonl"

# First characters of each file: a later tuning replaces only files that begin so.
FILE_PREFIXES = {
    PARAMETERS: "# Found by trackslip tune",
    TABLE: f"# What {PARAMETERS} rests on",
    NUMBERS: "{",
}


def write_evidence(folder: Path, tuning: Tuning, p: SlipEstimatorParameters) -> None:
    """Write parameters and table; ``p``: parameters before the tuning.

    Raises:
        InputError: the folder cannot be written.
    """
    values = to_flat(change_parameters(p, tuning.values))
    names = [full_name for name in tuning.values for full_name in matching_names(p, name)]
    tuned_values = {name: values[name] for name in names}
    bags = ", ".join(printable(bag, len(bag)) for bag in tuning.bags)
    text = f"{FILE_PREFIXES[PARAMETERS]} on {bags}; what it rests on is in {TABLE}.\n"
    text += f"# {printable(tuning.verdict, len(tuning.verdict))}\n"
    text += yaml.safe_dump({NODE: {"ros__parameters": unflatten(tuned_values)}}, sort_keys=False)
    make_folder("output", folder)
    write_file("output", folder / PARAMETERS, text)
    write_file("output", folder / TABLE, f"{FILE_PREFIXES[TABLE]}\n\n{table(tuning)}\n")


def numbers(tuning: Tuning) -> dict[str, Any]:
    """The results as JSON."""
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
        "improves_unseen": tuning.improves_unseen if tuning.folds else None,
        "verdict": tuning.verdict,
    }


def table(tuning: Tuning) -> str:
    """Markdown tables: the values, then the scores of each bag before, after and when left out."""
    values = []
    for name, value in tuning.values.items():
        left_out = [fold.values[name] for fold in tuning.folds]
        range_ = f"{min(left_out):.4g} to {max(left_out):.4g}" if left_out else ""
        values.append([name, f"{tuning.values_before[name]:.4g}", f"{value:.4g}", range_])
    sources = sorted({source for score in tuning.before for source in score.nis})
    rows = []
    unseen = {fold.bag: fold.score for fold in tuning.folds}
    for bag, name in enumerate(short_names([Path(bag).resolve() for bag in tuning.bags])):
        stages = (("before", tuning.before[bag]), ("after", tuning.after[bag]), ("unseen", unseen.get(bag)))
        rows += [[name, stage, *_score_cells(score, sources)] for stage, score in stages if score is not None]
    heading = ["bag", "", "ln likelihood", *(f"NIS {source}" for source in sources), "rejected"]
    heading += ["position m", "heading rad", "NEES", "ln pose"]
    notes = (
        "ln likelihood: mean of a measurement; ln pose: of a pose of the reference. NIS: mean of a source's "
        "normalised innovation squared over its degrees of freedom, 1 if consistent; NEES: of the pose's "
        "against the reference, 3 if consistent."
    )
    if tuning.folds:
        notes += " Unseen: with the values found on the other bags alone, whose range the first table gives."
    notes += f"\n\n{tuning.verdict}"
    first = markdown_table(["parameter", "before", "after", "without one bag"], values, 1)
    return "\n".join([*first, "", *markdown_table(heading, rows, 2), "", notes])


def _score_cells(score: Score, sources: Sequence[str]) -> list[str]:
    nis = [_number(score.nis.get(source, math.nan), ".2f") for source in sources]
    errors = (_number(score.position, ".4f"), _number(score.heading, ".4f"), _number(score.nees, ".2f"))
    pose = _number(score.pose_log_likelihood, ".2f")
    return [f"{score.log_likelihood:.3f}", *nis, str(sum(score.rejected.values())), *errors, pose]


def _number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else ""
