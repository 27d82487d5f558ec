# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Output of the soil estimator in a replay: messages, lines for a terminal, JSON."""

from collections.abc import Iterator
from typing import Any

from trackslip_bags.messages import make
from trackslip_common.config_files import parameters_text
from trackslip_common.parameters import to_flat
from trackslip_common.tally import Tally
from trackslip_estimation.soil import conversions
from trackslip_estimation.soil.soil_parameters import NODE, PARAMETERS
from trackslip_tools.replay.soil import SoilReplay
from trackslip_tools.report.quantities import found_soil


def soil_messages(result: SoilReplay) -> Iterator[tuple[str, Any, int]]:
    """Topic, message and stamp of the parameters and of each output."""
    outputs = result.outputs
    if outputs:
        text = parameters_text(to_flat(result.parameters), NODE)
        yield PARAMETERS, make("std_msgs/msg/String", data=text), outputs[0].stamp_ns
    for output in outputs:
        message = conversions.message_of(make, output, result.parameters.frame)
        yield conversions.topic_of(output), message, output.stamp_ns


def soil_summary(result: SoilReplay) -> dict[str, Any] | None:
    """The last state of the soil for ``--json``; None without a state."""
    if not result.states:
        return None
    last = result.states[-1]
    strength = last.strength
    content: dict[str, Any] = {
        "mu_r": last.mu_r,
        "mu_l": last.mu_l,
        "K": strength.shear_modulus,
        "K_interval": strength.shear_modulus_interval,
        "F_max": strength.thrust_limit,
        "F_max_interval": strength.thrust_limit_interval,
        "identifiable": strength.identifiable,
        "reason": strength.reason,
        "classes": last.classes,
        "rejected": result.rejected.by_source(),
    }
    if result.live is not None:
        content["replay_matches"] = result.live.matches
    return content


def rejection_lines(rejected: Tally) -> list[str]:
    """A line for each source and reason of rejected messages."""
    return [
        f"  {source:<24}{n:>8} not used: {reason}"
        for source, reasons in rejected.by_source().items()
        for reason, n in reasons.items()
    ]


def soil_lines(result: SoilReplay) -> list[str]:
    """The last state of the soil, as lines for a terminal."""
    lines = rejection_lines(result.rejected)
    if not result.states:
        return lines
    last = result.states[-1]
    strength = last.strength
    (k_low, k_high), (f_low, f_high) = strength.shear_modulus_interval, strength.thrust_limit_interval
    mu_r = f"μ_r {last.mu_r:.3f} ± {last.mu_r_variance**0.5:.3f}"
    mu_l = f"mobilised μ_l {last.mu_l:.3f} ± {last.mu_l_variance**0.5:.3f}"
    modulus = f"K {100 * strength.shear_modulus:.2f} cm ({100 * k_low:.2f} to {100 * k_high:.2f})"
    limit = f"F_max {strength.thrust_limit:.0f} N ({f_low:.0f} to {f_high:.0f})"
    lines += [f"soil   {mu_r}  {mu_l}", f"  {modulus}  {limit}"]
    if not strength.identifiable:
        lines.append(f"  not identifiable: {strength.reason}")
    likely = sorted(last.classes.items(), key=lambda item: -item[1])[:3]
    if likely:
        if not found_soil(last.classes, is_identifiable=strength.identifiable):
            lines.append("  the class is undetermined; likeliest:")
        lines.append("  " + "  ".join(f"{name} {100 * p:.0f} %" for name, p in likely))
    return lines if result.live is None else [*lines, str(result.live)]
