# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""How long the truth takes, for ``make bench``."""

import time

from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_sim.truth.simulate import simulate


def drive_seconds(duration: float = 60.0, soil: str = "sand") -> float:
    """Seconds for ``duration`` s of the field trial in mode ``shear``, compiled and warm, on one core."""
    scenario = load_scenario("field_trial")
    simulate(scenario.stretched(0.1), soil=soil)
    start = time.perf_counter()
    simulate(scenario.stretched(duration), soil=soil)
    return time.perf_counter() - start


if __name__ == "__main__":
    print(f"truth, 60 s of driving: {drive_seconds():.2f} s (bar: 2 s)")
