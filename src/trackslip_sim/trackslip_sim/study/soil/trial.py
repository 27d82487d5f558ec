# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""One run of the soil estimator on the shear truth, drawn from one seed.

Encoders, gyro, fixes and pressures have the noise of the emulator. Slip estimator and soil estimator process
them in the order of arrival.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.vehicle_files import vehicle_layer
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Measurement, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, load_slip_parameters
from trackslip_estimation.slip.records import to_records
from trackslip_estimation.soil.records import Hydraulics, inputs_from_estimates
from trackslip_estimation.soil.soil_estimator import SoilEstimator, SoilOutput
from trackslip_estimation.soil.soil_parameters import SoilEstimatorParameters, load_soil_parameters
from trackslip_sim.machine.sensors import SensorNoise, tilt_readings
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_sim.scenarios.scenario import Scenario, Segment, load_scenario
from trackslip_sim.study.soil.parameters import SoilStudyParameters, load_soil_study_parameters
from trackslip_sim.truth.record import Truth
from trackslip_sim.truth.settings import load_settings
from trackslip_sim.truth.simulate import simulate

START_NS = 1_000_000_000  # the stamp at time 0 of the truth


@dataclass(frozen=True)
class Trial:
    """Drive and seed of one run."""

    soil: str  # at the start of the drive
    sigma_xy: float  # m, of the fixes
    seed: int
    drawn: bool = False  # a machine drawn from the estimator's priors about the nominal one
    scenario: str = "field_trial"
    duration: float = 0.0  # s, the scenario repeated or cut; 0: unchanged
    standstill: float = 0.0  # s, before the scenario
    terrain: str = ""  # in config/terrains, or a file; empty: the scenario's own


@dataclass(frozen=True)
class Setting:
    """Parameters common to all runs."""

    study: SoilStudyParameters
    slip: SlipEstimatorParameters
    soil: SoilEstimatorParameters
    noise: SensorNoise


class Readings(NamedTuple):
    """Sensor readings of one drive."""

    arrivals: Sequence[Measurement]  # measurements for the slip estimator, in the order of arrival
    pressures: Sequence[Hydraulics]  # one at each stamp of the sprockets
    offsets: FloatArray  # (2,) Pa, of the left and the right transducer


def load_setting(
    study: SoilStudyParameters | None = None,
    slip: Mapping[str, Any] = MappingProxyType({}),
    soil: Mapping[str, Any] = MappingProxyType({}),
) -> Setting:
    """The defaults of ``config/``; dotted names in ``slip`` and ``soil`` replace those of the estimators.

    Raises:
        InputError: a name is unknown or a value refused.
    """
    slip_p = load_slip_parameters(slip)
    soil_p = load_soil_parameters(vehicle_layer(slip_p.vehicle), soil)
    noise = load_emulator_parameters({}).noise
    return Setting(study or load_soil_study_parameters({}), slip_p, soil_p, noise)


def simulate_trial(trial: Trial, scenario: Scenario | None = None, setting: Setting | None = None) -> Truth:
    """True motion of the nominal or a drawn machine; ``scenario`` replaces that of the trial, unchanged."""
    scenario, setting = scenario or _scenario_of(trial), setting or load_setting()
    vehicle, settings = setting.soil.vehicle.whole(), load_settings()
    if trial.drawn:
        p = setting.soil.strength
        radius, efficiency, load = np.random.default_rng((trial.seed, 1)).standard_normal(3).tolist()
        vehicle = dataclasses.replace(
            vehicle,
            rolling_radius=vehicle.rolling_radius * (1.0 + p.slip_bias_stddev * radius),
            motor_efficiency=vehicle.motor_efficiency * (1.0 + p.thrust_scale_stddev * efficiency),
        )
        settings = dataclasses.replace(settings, load_x=setting.study.load_stddev * load)
    return simulate(scenario, soil=trial.soil, vehicle=vehicle, settings=settings)


def _scenario_of(trial: Trial) -> Scenario:
    scenario = load_scenario(trial.scenario, trial.terrain, trial.duration)
    standing = (Segment(trial.standstill, 0.0, 0.0),) if trial.standstill > 0.0 else ()
    return dataclasses.replace(scenario, segments=(*standing, *scenario.segments))


def estimator_outputs(readings: Readings, setting: Setting) -> Iterator[SoilOutput]:
    """All outputs of the soil estimator."""
    slip_estimator, soil_estimator = SlipEstimator(setting.slip), SoilEstimator(setting.soil)
    results = slip_estimator.process_records(to_records(readings.arrivals, slip_estimator.sources))
    samples = results[[isinstance(measurement, Sprockets) for measurement in readings.arrivals]]
    inputs = np.repeat(inputs_from_estimates(samples["estimate"]), 2)  # each reading, then its state
    for record, reading in zip(inputs[::2], readings.pressures, strict=True):
        reading.write_to(record)
    is_published = np.ones(len(inputs), np.bool_)
    is_published[1::2] = samples["published"]
    for outputs in soil_estimator.advance_all(inputs[is_published]):
        yield from outputs.in_order()


def draw_readings(trial: Trial, truth: Truth, setting: Setting) -> Readings:
    """Draw the sensor readings of a drive."""
    random = np.random.default_rng((trial.seed, round(trial.sigma_xy * 1e6)))
    arrivals = _arrivals(trial, truth, setting, random)
    return Readings(arrivals, *_pressures(truth, setting, random))


def _arrivals(trial: Trial, truth: Truth, setting: Setting, random: np.random.Generator) -> list[Measurement]:
    """Measurements in the order of arrival; the first fix, at rest, is the first of them."""
    p, noise, resolution = setting.study, setting.noise, setting.slip.encoder_resolution
    arrivals: list[tuple[float, int, Measurement]] = []
    at = truth.interpolate(np.arange(0.0, truth.duration, 1.0 / p.sprocket_rate))
    angles = np.stack((at.left_angle, at.right_angle), axis=1)
    phase = resolution * random.uniform(0.0, 1.0, 2)
    counted = np.floor((angles + phase) / resolution) * resolution
    for t, (left, right), v_l, v_r in zip(at.t, counted.tolist(), at.left_speed, at.right_speed, strict=True):
        arrivals.append((t, 1, Sprockets("sprockets", _stamp_ns(t), float(v_l), float(v_r), (left, right))))
    at = truth.interpolate(np.arange(0.5 / p.gyro_rate, truth.duration, 1.0 / p.gyro_rate))
    rates = at.yaw_rate + noise.gyro_bias + noise.gyro_stddev * random.standard_normal(len(at))
    tilts = tilt_readings(truth, at.t, noise, np.random.default_rng((trial.seed, 2)))
    rate_variance, force_variance = noise.gyro_stddev**2, noise.acceleration_stddev**2
    for t, rate, (p_rate, q_rate, f_x, f_y, f_z) in zip(at.t, rates.tolist(), tilts.tolist(), strict=True):
        gyro = rate, rate_variance, (p_rate, q_rate), (rate_variance, rate_variance)
        arrivals.append((t, 2, YawRate("imu/data_raw", _stamp_ns(t), *gyro, (f_x, f_y, f_z), force_variance)))
    at = truth.interpolate(np.arange(0.0, truth.duration, 1.0 / p.fix_rate))
    deviations = np.array((trial.sigma_xy, trial.sigma_xy, p.sigma_heading))
    poses = np.stack((at.x, at.y, at.yaw), axis=1) + deviations * random.standard_normal((len(at), 3))
    for t, pose in zip(at.t, poses, strict=True):
        fix = PoseFix("box_pose", _stamp_ns(t), pose, np.diag(np.square(deviations)))
        arrivals.append((t + p.fix_delay if t > 0.0 else 0.0, 0, fix))
    return [measurement for _, _, measurement in sorted(arrivals, key=lambda arrival: arrival[:2])]


def _pressures(
    truth: Truth, setting: Setting, random: np.random.Generator
) -> tuple[list[Hydraulics], FloatArray]:
    """Pressures at the stamps of the sprockets, and the offsets of the transducers (2,), Pa."""
    at = truth.interpolate(np.arange(0.0, truth.duration, 1.0 / setting.study.sprocket_rate))
    offsets = setting.study.offset_stddev * random.standard_normal(2)
    values = np.stack((at.left_pressure, at.right_pressure), axis=1) + offsets
    values += setting.noise.pressure_stddev * random.standard_normal(values.shape)
    rows = np.column_stack((values, at.left_spool, at.right_spool)).tolist()
    return [Hydraulics(_stamp_ns(t), *row) for t, row in zip(at.t, rows, strict=True)], offsets


def _stamp_ns(t: float) -> int:
    return START_NS + round(float(t) * 1e9)
