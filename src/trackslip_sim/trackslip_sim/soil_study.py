# SPDX-License-Identifier: Apache-2.0
"""How good the soil estimator is on a known truth: ``python -m trackslip_sim.soil_study --help``.

Each run drives the field trial on the shear truth of one soil; encoders, gyro, fixes and pressures are drawn
as the emulator has them, and pass the slip estimator and the soil estimator in the order of their arrival.
"""

import argparse
import dataclasses
import sys
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackslip_common.errors import ExitCode, InputError
from trackslip_estimation.measurements import Measurement, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip_estimator import SlipEstimator
from trackslip_estimation.slip_parameters import SlipEstimatorParameters, load_slip_parameters
from trackslip_estimation.soil.classes import limit_of
from trackslip_estimation.soil.records import Hydraulics, inputs_of
from trackslip_estimation.soil.soil_estimator import SoilEstimator, SoilState
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_estimation.soils import load_soils
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_sim.scenarios import Scenario, load_scenario
from trackslip_sim.sensors import SensorNoise
from trackslip_sim.truth.record import Truth
from trackslip_sim.truth.settings import load_settings
from trackslip_sim.truth.simulate import simulate

FloatArray = NDArray[np.float64]

SOILS = ("sand", "sandy_loam", "clayey_soil", "dry_clay")
_START_NS = 1_000_000_000
_SPROCKET_PERIOD, _GYRO_PERIOD, _FIX_PERIOD = 0.01, 0.084375, 0.2  # s
_FIX_DELAY = 0.25  # s, until a fix arrives
_HEADING_STDDEV = 0.01  # rad, of a fix
_OFFSET_STDDEV = 1e5  # Pa, of a pressure transducer
_LOAD_STDDEV = 0.05  # m, of the centre of gravity of a drawn machine


@dataclass(frozen=True)
class Trial:
    """One run."""

    soil: str
    sigma_xy: float  # m, of the fixes
    seed: int
    drawn: bool = False  # a machine that differs from the nominal one as the estimator's parameters expect
    scenario: str = "field_trial"


@dataclass(frozen=True)
class Result:
    """What was found at the end of a run, over the truth; intervals from 5 to 95 %."""

    trial: Trial
    modulus: float
    modulus_interval: tuple[float, float]
    limit: float
    limit_interval: tuple[float, float]
    identifiable: bool
    reason: str
    probability: float  # of the true class


def run(trial: Trial) -> Result:
    """Drive, estimate, compare."""
    states = list(estimates(trial, drive(trial)))
    soils, vehicle = load_soils(), load_soil_parameters().vehicle
    truth = soils[trial.soil]
    modulus, limit = truth.value("shear_modulus"), limit_of(truth, vehicle)
    last = states[-1]
    found = last.strength
    return Result(
        trial,
        found.shear_modulus / modulus,
        _over(found.shear_modulus_interval, modulus),
        found.thrust_limit / limit,
        _over(found.thrust_limit_interval, limit),
        found.identifiable,
        found.reason,
        last.classes[trial.soil],
    )


def drive(trial: Trial, scenario: Scenario | None = None) -> Truth:
    """The true motion of the nominal or of a drawn machine."""
    scenario = scenario or load_scenario(trial.scenario)
    if not trial.drawn:
        return simulate(scenario, soil=trial.soil)
    p = load_soil_parameters()
    radius, efficiency, load = np.random.default_rng((trial.seed, 1)).standard_normal(3)
    vehicle = dataclasses.replace(
        p.vehicle,
        rolling_radius=p.vehicle.rolling_radius * (1.0 + p.strength.slip_bias_stddev * radius),
        motor_efficiency=p.vehicle.motor_efficiency * (1.0 + p.strength.thrust_scale_stddev * efficiency),
    )
    settings = dataclasses.replace(load_settings(), load_x=_LOAD_STDDEV * load)
    return simulate(scenario, soil=trial.soil, vehicle=vehicle, settings=settings)


def estimates(trial: Trial, truth: Truth) -> Iterator[SoilState]:
    """What the soil estimator publishes of a drive."""
    random = np.random.default_rng((trial.seed, round(trial.sigma_xy * 1e6)))
    noise = load_emulator_parameters({}).noise
    slip_p, soil_p = load_slip_parameters(), load_soil_parameters()
    slip_estimator, soil_estimator = SlipEstimator(slip_p), SoilEstimator(soil_p)
    pressures = _pressures(truth, noise, random)
    for measurement in _arrivals(trial, truth, noise, slip_p, random):
        _, estimate = slip_estimator.advance(measurement)
        if isinstance(measurement, Sprockets):
            outputs = soil_estimator.advance(next(pressures))
            for given in () if estimate is None else inputs_of(estimate):
                outputs += soil_estimator.advance(given)
            yield from (output for output in outputs if isinstance(output, SoilState))


def _arrivals(
    trial: Trial,
    truth: Truth,
    noise: SensorNoise,
    p: SlipEstimatorParameters,
    random: np.random.Generator,
) -> list[Measurement]:
    """All that the slip estimator gets, in the order of arrival; the first fix, at rest, comes first."""
    arrivals: list[tuple[float, int, Measurement]] = []
    at = truth.interpolate(np.arange(0.0, truth.duration, _SPROCKET_PERIOD))
    angles = np.stack((at.left_angle, at.right_angle), axis=1)
    zero = p.encoder_resolution * random.uniform(0.0, 1.0, 2)
    counted = np.floor((angles + zero) / p.encoder_resolution) * p.encoder_resolution
    for t, (left, right), v_l, v_r in zip(at.t, counted.tolist(), at.left_speed, at.right_speed, strict=True):
        arrivals.append((t, 1, Sprockets("sprockets", _stamp(t), float(v_l), float(v_r), (left, right))))
    at = truth.interpolate(np.arange(0.5 * _GYRO_PERIOD, truth.duration, _GYRO_PERIOD))
    rates = at.yaw_rate + noise.gyro_bias + noise.gyro_stddev * random.standard_normal(len(at))
    for t, rate in zip(at.t, rates.tolist(), strict=True):
        arrivals.append((t, 2, YawRate("imu/data_raw", _stamp(t), rate, noise.gyro_stddev**2)))
    at = truth.interpolate(np.arange(0.0, truth.duration, _FIX_PERIOD))
    deviations = np.array((trial.sigma_xy, trial.sigma_xy, _HEADING_STDDEV))
    poses = np.stack((at.x, at.y, at.yaw), axis=1) + deviations * random.standard_normal((len(at), 3))
    for t, pose in zip(at.t, poses, strict=True):
        fix = PoseFix("box_pose", _stamp(t), pose, np.diag(np.square(deviations)))
        arrivals.append((t + _FIX_DELAY if t > 0.0 else 0.0, 0, fix))
    return [measurement for _, _, measurement in sorted(arrivals, key=lambda arrival: arrival[:2])]


def _pressures(truth: Truth, noise: SensorNoise, random: np.random.Generator) -> Iterator[Hydraulics]:
    """At the stamps of the sprockets; each transducer has an offset."""
    at = truth.interpolate(np.arange(0.0, truth.duration, _SPROCKET_PERIOD))
    values = np.stack((at.left_pressure, at.right_pressure), axis=1)
    values += _OFFSET_STDDEV * random.standard_normal(2)
    values += noise.pressure_stddev * random.standard_normal(values.shape)
    for t, (left, right), spools in zip(
        at.t, values.tolist(), zip(at.left_spool, at.right_spool, strict=True), strict=True
    ):
        yield Hydraulics(_stamp(t), left, right, float(spools[0]), float(spools[1]))


def _stamp(t: float) -> int:
    return _START_NS + round(float(t) * 1e9)


def _over(interval: tuple[float, float], truth: float) -> tuple[float, float]:
    low, high = interval
    return low / truth, high / truth


def table(results: Sequence[Result]) -> str:
    """One line for each soil and σ."""
    off = f"{'median':>6} {'worst':>5} {'in 90%':>6}"
    lines = [
        f"{'':24} | {'F_max off':19} | {'K off':28} |",
        f"{'soil':12} {'σ_xy m':>6} {'runs':>4} | {off} | {off} {'high/low':>8} | {'known':>5} {'class':>5}",
    ]
    for soil, sigma in dict.fromkeys((r.trial.soil, r.trial.sigma_xy) for r in results):
        these = [r for r in results if (r.trial.soil, r.trial.sigma_xy) == (soil, sigma)]
        lines.append(f"{soil:12} {sigma:6g} {len(these):4d} | {_row(these)}")
    return "\n".join(lines)


def _row(results: Sequence[Result]) -> str:
    def errors(values: Iterable[float]) -> str:
        off = np.abs(np.array(list(values)) - 1.0)
        return f"{np.median(off):6.1%} {off.max():5.0%}"

    def coverage(intervals: Iterable[tuple[float, float]]) -> str:
        return f"{np.mean([low <= 1.0 <= high for low, high in intervals]):6.0%}"

    limit = f"{errors(r.limit for r in results)} {coverage(r.limit_interval for r in results)}"
    modulus = f"{errors(r.modulus for r in results)} {coverage(r.modulus_interval for r in results)}"
    ratio = np.median([r.modulus_interval[1] / r.modulus_interval[0] for r in results])
    known = np.mean([r.identifiable for r in results])
    probability = np.median([r.probability for r in results])
    return f"{limit} | {modulus} {ratio:8.2f} | {known:5.0%} {probability:5.2f}"


def main(arguments: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(
        description="Monte Carlo of the soil estimator on the shear truth: errors and coverage of F_max, K.",
        epilog="example: python -m trackslip_sim.soil_study --soils sand dry_clay --sigmas 0.05 --seeds 20",
    )
    add = parser.add_argument
    add("--soils", nargs="+", default=SOILS, metavar="NAME", help="of config/soils.yaml")
    add("--sigmas", nargs="+", type=float, default=(0.01, 0.05), metavar="M", help="of the fixes")
    add("--seeds", type=int, default=5, metavar="N", help="runs of each")
    add(
        "--drawn",
        action="store_true",
        help="radius, efficiency and load as uncertain as the estimator thinks",
    )
    add("--scenario", default="field_trial", metavar="NAME", help="of config/scenarios, or a file")
    add("--jobs", type=int, default=1, metavar="N", help="processes")
    args = parser.parse_args(arguments)
    trials = [
        Trial(soil, sigma, seed, args.drawn, args.scenario)
        for soil in args.soils
        for sigma in args.sigmas
        for seed in range(args.seeds)
    ]
    try:
        with ProcessPoolExecutor(args.jobs) as pool:
            print(table(list(pool.map(run, trials))))
    except InputError as error:
        print(f"soil_study: {error}", file=sys.stderr)
        return ExitCode.BAD_INPUT
    return ExitCode.DONE


if __name__ == "__main__":
    sys.exit(main())
