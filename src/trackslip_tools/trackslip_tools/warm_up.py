# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Compiles the kernels of both estimators; fast if the compiled kernels are cached."""

from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Sprockets
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.records import to_records
from trackslip_estimation.soil.records import Hydraulics
from trackslip_estimation.soil.soil_estimator import SoilEstimator
from trackslip_estimation.soil.soil_parameters import load_soil_parameters


def compile_kernels() -> None:
    """Compile by a step of each estimator that calls all kernels."""
    estimator = SlipEstimator(load_slip_parameters({"start": "initial_pose"}))
    samples = [Sprockets("sprockets", k * 10_000_000, 1.0, 1.0, (0.01 * k, 0.01 * k)) for k in range(3)]
    estimator.process_records(to_records(samples, estimator.sources))
    SoilEstimator(load_soil_parameters()).advance(Hydraulics(0, 0.0, 0.0, 0.0, 0.0))
