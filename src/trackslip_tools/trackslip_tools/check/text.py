# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The setup check as text: what was found comes first, with the line that undoes it."""

import re

from trackslip_estimation.setup_check.finding import Result, odds_text
from trackslip_tools.terminal_text import table, wrapped

_SETTING = re.compile(r"\bslip_estimator\.[\w.]+=[^\s,;]+")


def settings(result: Result) -> list[str]:
    """What the remedies set, as ``--set`` takes it; empty where a cause has another remedy."""
    found = [_SETTING.findall(cause.remedy) for cause in result.causes]
    return [one for settings in found for one in settings] if all(found) else []


def finding(result: Result) -> str:
    """What a command prints before its own results: one line for each cause, or that there is none."""
    if result.is_plausible:
        open_questions = [wrapped(f"setup: {one.what}: {one.needed}") for one in result.open_questions]
        return "\n".join(open_questions) or "setup plausible"
    lines = []
    for cause in result.causes:
        lines += [f"setup: {cause.cause} ({cause.source}): {cause.evidence}", f"  {cause.remedy}"]
    return "\n".join(map(wrapped, lines))


def whole(result: Result) -> str:
    """What ``trackslip check`` prints: facts, causes with odds and remedies, and what cannot be decided."""
    parts = ["\n".join(map(wrapped, result.facts))] if result.facts else []
    if result.causes:
        rows = [(c.cause, c.source, odds_text(c.odds)) for c in result.causes]
        parts.append(table(("cause", "source", "odds"), rows, (False, False, True)))
        parts += [
            "\n".join(map(wrapped, (f"{c.cause}: {c.evidence}", f"  {c.remedy}"))) for c in result.causes
        ]
    else:
        parts.append(finding(result))
    if result.undetermined:
        lines = [f"  {one.what}: {one.needed}" for one in result.undetermined]
        parts.append("\n".join(["not decided by this drive", *map(wrapped, lines)]))
    return "\n\n".join(parts)
