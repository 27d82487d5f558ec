# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Entry of the slip estimator in /diagnostics: waiting, running, or what is missing."""

from collections.abc import Mapping
from typing import Any

from trackslip_common.nodes.health import ERROR, OK, WARN, Health
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.explanations import EXPLANATIONS, recent_events_text
from trackslip_estimation.slip.learned_text import learned_quantities
from trackslip_estimation.slip.source_watch import SourceWatch
from trackslip_estimation.slip.sources import nonempty_names

_SILENCE_TIMEOUT = 0.2  # s, shortest silence that is reported


def estimator_health(
    estimator: SlipEstimator,
    watch: SourceWatch,
    silence_s: float | None,
    counts: Mapping[str, Any],
    sprocket_fault: str = "",
) -> Health:
    """Return the entry.

    ``silence_s``: since the last usable sprocket sample, None before the first sample;
    ``sprocket_fault``: why the last sample is unusable.
    """
    p, now_ns = estimator.parameters, estimator.newest_ns or 0
    explanations = estimator.competing_explanations.text
    learned = learned_quantities(estimator.learned, estimator.learned_context)
    values = {
        **counts,
        "restarts": estimator.restarts,
        "divergences": estimator.divergences,
        "attitude": estimator.attitude,
        **{f"{source} nis": text for source, text in watch.innovations(now_ns).items()},
        **{quantity.form.label: quantity.sentence for quantity in learned},
        EXPLANATIONS: explanations or "none needed",
        "last events": recent_events_text(estimator.read_events()),
    }
    if silence_s is not None and silence_s > max(p.sprocket_timeout, _SILENCE_TIMEOUT):
        if sprocket_fault:
            return Health(ERROR, f"sprockets rejected for {silence_s:.1f} s ({sprocket_fault})", values)
        return Health(ERROR, f"sprockets silent for {silence_s:.1f} s", values)
    diverged = "re-initialised, the estimate was not finite; " if watch.has_diverged(now_ns) else ""
    if not estimator.started:
        awaited = (
            "sprockets" if silence_s is None else f"a fix on {', '.join(nonempty_names(p.pose_sources))}"
        )
        return Health(WARN, f"{diverged}waiting for {awaited}", values)
    if estimator.frozen:
        return Health(WARN, "frozen: poses are ignored", values)
    if diverged:
        return Health(WARN, f"{diverged}running again", values)
    if explanations:
        return Health(WARN, explanations, values)
    if lost := watch.lost_sources_text(now_ns):
        return Health(WARN, f"nothing accepted of {lost}", values)
    return Health(OK, "running", values)
