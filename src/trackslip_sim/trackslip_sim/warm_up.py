# SPDX-License-Identifier: Apache-2.0
"""Compiles every kernel once, so that no first run has to: ``python -m trackslip_sim.warm_up``."""

from trackslip_estimation.slip_parameters import load_slip_parameters, make_filter
from trackslip_sim.scenarios import load_scenario
from trackslip_sim.truth.simulate import MODES, simulate

_SHORT = 0.1  # s


def main() -> None:
    """Run each kernel; what is compiled already is only loaded."""
    scenario = load_scenario("straight").stretched(_SHORT)
    for mode in MODES:
        simulate(scenario, mode=mode)
    make_filter(load_slip_parameters())


if __name__ == "__main__":
    main()
