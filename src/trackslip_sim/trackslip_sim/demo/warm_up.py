# SPDX-License-Identifier: Apache-2.0
"""Compiles what the emulator and the soil estimator call: ``python -m trackslip_sim.demo.warm_up``.

``make setup`` runs it beside a short replay, which compiles the slip estimator; what is compiled already is
only loaded. The studies and the thesis' own truth compile their kernels when they are first run.
"""

from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.soil.soil_estimator import SoilEstimator
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_sim.machine.hydraulics import Sensing, soil_inputs
from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_sim.truth.simulate import simulate

_ROLLING = 4.0  # s of the slalom, half of them straight on


def main() -> None:
    """Drive a short way, and estimate the soil along it."""
    soil = SoilEstimator(load_soil_parameters())
    truth = simulate(load_scenario("slalom").stretched(_ROLLING))
    for given in soil_inputs(truth, soil.parameters.vehicle, load_slip_parameters().motion, Sensing()):
        soil.advance(given)


if __name__ == "__main__":
    main()
