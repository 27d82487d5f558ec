# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The soil estimator's state for /diagnostics: waiting, running, what is wrong, or a track in trouble."""

from collections.abc import Mapping
from typing import Any

from trackslip_common.nodes.health import ERROR, OK, WARN, Health
from trackslip_estimation.soil.soil_estimator import SoilEstimator

_PATIENCE = 1.0  # s of silence


def soil_health(estimator: SoilEstimator, silent: float | None, counts: Mapping[str, Any]) -> Health:
    """``silent``: seconds since the slip estimator was heard, None before the first time."""
    values = {**counts, "restarts": estimator.restarts, **_findings(estimator)}
    if silent is None:
        return Health(WARN, "waiting for machine_state", values)
    if silent > _PATIENCE:
        return Health(ERROR, f"slip estimator silent for {silent:.1f} s", values)
    if estimator.faults:
        names = ", ".join(fault.value for fault in estimator.faults)
        return Health(ERROR, f"{names}: the estimates are held", values)
    if any(estimator.stalled):
        text = f"stalled: {_sides(estimator.stalled)} commanded and under pressure, but not turning"
        return Health(WARN, text, values)
    if any(estimator.struggling):
        return Health(WARN, f"getting stuck: {_sides(estimator.struggling)} at the limit of the soil", values)
    return Health(OK, "running", values)


def _sides(are_so: tuple[bool, bool]) -> str:
    """Those of which something is so."""
    return " and ".join(side for side, is_so in zip(("left", "right"), are_so, strict=True) if is_so)


def _findings(estimator: SoilEstimator) -> dict[str, Any]:
    """K, F_max and what the check of the flow says."""
    found = estimator.strength
    (k_low, k_high), (f_low, f_high) = found.shear_modulus_interval, found.thrust_limit_interval
    efficiency = estimator.volumetric_efficiency
    return {
        "shear modulus (cm)": f"{100 * found.shear_modulus:.2f} ({100 * k_low:.2f} to {100 * k_high:.2f})",
        "tractive effort (N)": f"{found.thrust_limit:.0f} ({f_low:.0f} to {f_high:.0f})",
        "identifiable": found.reason or "yes",
        "volumetric efficiency": "unknown" if efficiency is None else f"{efficiency:.3f}",
    }
