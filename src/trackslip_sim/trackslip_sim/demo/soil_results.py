# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The soil's part of a demo run: live forces and soil against the truth, and replay against live."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.topics import FORCES, SOIL, TRUE_FORCES, TRUE_SOIL
from trackslip_tools.replay.series import Series
from trackslip_tools.replay.soil import SoilComparison, SoilReplay

FloatArray = NDArray[np.float64]

MODULUS, LIMIT = "shear_modulus", "max_tractive_effort"  # their 5 and 95 % points: _lower, _upper


class Finding(NamedTuple):
    """One number at the end of the drive."""

    name: str
    found: float
    interval: tuple[float, float]  # 5 % and 95 % points
    true: float


@dataclass(frozen=True, eq=False)
class SoilResult:
    """What the table and the picture show."""

    forces: Series
    true_forces: Series
    soil: Series
    true_soil: Series
    thrust_rmse: float  # N
    live: SoilComparison
    likely: tuple[str, float]  # the most probable class

    @property
    def findings(self) -> list[Finding]:
        """μ_r, K and F_max at the end; the mobilised μ_l is in the picture."""
        last, true = self.soil.rows[-1], self.true_soil.rows[-1]
        spread = 1.645 * float(np.sqrt(last["mu_r_variance"]))
        mu_r = float(last["mu_r"])
        found = [Finding("μ_r", mu_r, (mu_r - spread, mu_r + spread), float(true["mu_r"]))]
        for name, field in (("K, m", MODULUS), ("F_max, N", LIMIT)):
            value, low, high = (float(last[f"{field}{end}"]) for end in ("", "_lower", "_upper"))
            found.append(Finding(name, value, (low, high), float(true[field])))
        return found

    def numbers(self) -> dict[str, Any]:
        """For the summary."""
        mu_r, modulus, limit = self.findings
        return {
            "thrust_rmse": self.thrust_rmse,
            "mu_r": mu_r.found,
            "K": modulus.found,
            "K_interval": modulus.interval,
            "F_max": limit.found,
            "F_max_interval": limit.interval,
            "identifiable": bool(self.soil["identifiable"][-1]),
            "class": self.likely[0],
            "replay_matches": self.live.matches,
        }


def soil_result(replayed: SoilReplay, from_ns: int) -> SoilResult | None:
    """From ``from_ns`` on; None where the bag lacks live or true forces or soil."""
    series = {name: rows.since(from_ns) for name, rows in replayed.series.items()}
    names = (FORCES, TRUE_FORCES, SOIL, TRUE_SOIL)
    if replayed.live is None or any(not len(series[name].stamps_ns) for name in names if name in series):
        return None
    if not all(name in series for name in names):
        return None
    forces, true_forces, soil, true_soil = (series[name] for name in names)
    classes = replayed.states[-1].classes
    likely = max(classes, key=lambda name: classes[name])
    return SoilResult(
        forces,
        true_forces,
        soil,
        true_soil,
        _rmse(forces, true_forces),
        replayed.live,
        (likely, classes[likely]),
    )


def _rmse(found: Series, true: Series) -> float:
    """Of both thrusts, at the stamps of what was found."""
    errors = [
        found[thrust] - np.interp(found.stamps_ns, true.stamps_ns, true[thrust])
        for thrust in ("left_thrust", "right_thrust")
    ]
    return float(np.sqrt(np.mean(np.square(errors))))
