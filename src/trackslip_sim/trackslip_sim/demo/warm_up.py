# SPDX-License-Identifier: Apache-2.0
"""Compiles every kernel once, so that no first run has to: ``python -m trackslip_sim.demo.warm_up``."""

import time
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from trackslip_estimation.box.fit import Rectangle, ray_cast
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
    """Run each kernel, and print how long that took; what is compiled already is only loaded."""
    for name, run in _FAMILIES.items():
        begin = time.process_time()
        run()
        print(f"{name}: {time.process_time() - begin:.1f} s", flush=True)


def _truth() -> None:
    scenario = load_scenario("straight").stretched(_SHORT)
    for mode in MODES:
        simulate(scenario, mode=mode)


def _box() -> None:
    ray_cast(np.array([[5.0, 0.0, 0.0]]), Rectangle(1.0, 1.0), np.zeros(1))


def _slip() -> None:
    make_filter(load_slip_parameters())


def _study() -> None:
    estimator = load_slip_parameters()
    study = load_study_parameters({"duration": 2.0, "settling": 1.0, "seeds": 1})
    drive = make_drive(study, estimator, study.soils[0])
    for name in TRUTHS:
        cell = next(cell for cell in cells(study) if cell.truth == name)
        evaluate(cell, drive, study, estimator)


def _soil() -> None:
    estimator = SoilEstimator(load_soil_parameters())
    truth = simulate(load_scenario("slalom").stretched(_ROLLING))
    motion = load_slip_parameters().motion
    for given in soil_inputs(truth, estimator.parameters.vehicle, motion, Sensing()):
        estimator.advance(given)


_FAMILIES: Mapping[str, Callable[[], None]] = MappingProxyType(
    {"truth": _truth, "box": _box, "slip estimator": _slip, "slip study": _study, "soil estimator": _soil}
)

if __name__ == "__main__":
    main()
