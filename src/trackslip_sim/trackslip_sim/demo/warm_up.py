# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Compiles kernels before the first run: ``python -m trackslip_sim.demo.warm_up [FAMILY…]``.

Compiled kernels are only loaded. ``make setup`` compiles the families of the demo, and by a short replay the
rest of the slip estimator. The studies and the thesis' truth compile their kernels at the first run.
"""

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numba

from trackslip_common.start import collect_garbage_seldom
from trackslip_estimation.box.fit import compile_fit
from trackslip_estimation.slip.config import CONFIG
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.local_odometry import LocalOdometry
from trackslip_estimation.slip.observations.altitude import update_height
from trackslip_estimation.slip.outputs import fill_outputs
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.records import ESTIMATE, MEASUREMENT, STATE
from trackslip_estimation.slip.tilt import update_attitude
from trackslip_estimation.soil.soil_estimator import SoilEstimator
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_sim.machine.hydraulics import InputErrors, soil_inputs
from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_sim.study.slip.drive import make_drive
from trackslip_sim.study.slip.evaluate import evaluate
from trackslip_sim.study.slip.parameters import cells, load_study_parameters
from trackslip_sim.truth.simulate import MODES, simulate

_TRUTH_DURATION = 0.1  # s
_SOIL_DURATION = 4.0  # s of the slalom, half of it straight


def main(families: Sequence[str]) -> None:
    """Compile the kernels of these families (or of all) and print the processor time of each."""
    collect_garbage_seldom()
    for name in families or FAMILIES:
        begin = time.process_time()
        FAMILIES[name]()
        print(f"{name}: {time.process_time() - begin:.1f} s", flush=True)


def _compile_truth() -> None:
    scenario = load_scenario("straight").with_duration(_TRUTH_DURATION)
    for mode in MODES:
        simulate(scenario, mode=mode)


def _compile_last() -> None:
    """Compile the kernels that the slip estimator needs last, in parallel with its own compilation."""
    state, measurement, c, estimate = map(numba.from_dtype, (STATE, MEASUREMENT, CONFIG, ESTIMATE))
    parts: tuple[tuple[Any, tuple[Any, ...]], ...] = (
        (update_attitude, (state, measurement, numba.int64, c)),
        (update_height, (state, measurement, c)),
        (fill_outputs, (state, c, estimate)),
    )
    for kernel, arguments in parts:
        kernel.compile(arguments)
    LocalOdometry()


def _compile_slip() -> None:
    SlipEstimator(load_slip_parameters())


def _compile_study() -> None:
    estimator = load_slip_parameters()
    study = load_study_parameters({"duration": 2.0, "settling": 1.0, "seeds": 1})
    drive = make_drive(study, estimator, study.soils[0])
    for name in study.truths:
        cell = next(cell for cell in cells(study) if cell.truth == name)
        evaluate(cell, drive, study, estimator)


def _compile_soil() -> None:
    estimator = SoilEstimator(load_soil_parameters())
    truth = simulate(load_scenario("slalom").with_duration(_SOIL_DURATION))
    motion = load_slip_parameters().motion
    for entry in soil_inputs(truth, estimator.parameters.vehicle.whole(), motion, InputErrors()):
        estimator.advance(entry)


FAMILIES: Mapping[str, Callable[[], None]] = MappingProxyType(
    {
        "last": _compile_last,
        "slip": _compile_slip,
        "truth": _compile_truth,
        "box": compile_fit,
        "soil": _compile_soil,
        "study": _compile_study,
    }
)

if __name__ == "__main__":
    main(sys.argv[1:])
