# SPDX-License-Identifier: Apache-2.0
"""Compiles every kernel once, so that no first run has to: ``python -m trackslip_sim.demo.warm_up``."""

from trackslip_estimation.slip.parameters import load_slip_parameters, make_filter
from trackslip_estimation.soil.soil_estimator import SoilEstimator
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_sim.machine.hydraulics import Sensing, soil_inputs
from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_sim.study.slip.drive import make_drive
from trackslip_sim.study.slip.evaluate import evaluate
from trackslip_sim.study.slip.parameters import TRUTHS, cells, load_study_parameters
from trackslip_sim.truth.simulate import MODES, simulate

_SHORT = 0.1  # s
_ROLLING = 4.0  # s of the slalom, half of them straight on


def main() -> None:
    """Run each kernel; what is compiled already is only loaded."""
    scenario = load_scenario("straight").stretched(_SHORT)
    for mode in MODES:
        simulate(scenario, mode=mode)
    estimator = load_slip_parameters()
    make_filter(estimator)
    study = load_study_parameters({"duration": 2.0, "settling": 1.0, "seeds": 1})
    drive = make_drive(study, estimator, study.soils[0])
    for name in TRUTHS:
        cell = next(cell for cell in cells(study) if cell.truth == name)
        evaluate(cell, drive, study, estimator)
    soil = SoilEstimator(load_soil_parameters())
    truth = simulate(load_scenario("slalom").stretched(_ROLLING))
    for given in soil_inputs(truth, soil.parameters.vehicle, estimator.motion, Sensing()):
        soil.advance(given)


if __name__ == "__main__":
    main()
