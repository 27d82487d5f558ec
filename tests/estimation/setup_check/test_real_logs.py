# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The setup check on logs of real robots and recorded runs: no false cause, only the injected one.

The whole matrix (each mistake, each log) is slow; it prints what is named, false or undetermined.
"""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from fixtures.fault_cases.robot_logs import FILES, FOLDER, is_present
from fixtures.setup_mistakes import AMBIGUOUS, MISTAKES, Mistake
from fixtures.setup_motion import holds
from fixtures.setup_variants import VARIANTS, piece

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import open_bag
from trackslip_common.arrays import FloatArray
from trackslip_estimation.setup_check.check import check
from trackslip_estimation.setup_check.collect import Collector
from trackslip_estimation.setup_check.grid import tracks_of_speeds
from trackslip_estimation.setup_check.log import Compass, Fixes, Gyro, Log, Machine, Tracks
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_sim.machine.excavator import simulate_drive
from trackslip_sim.machine.offline import record_drive
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_tools.cli.replay_options import parameters_of
from trackslip_tools.replay.inputs import InputStream

BAGS = Path(__file__).parents[3] / "bags"
VEHICLES = ("excavator_20t", "pc05", "pc05_cab")  # vehicles with hydraulics
RUNS = sorted(path.parent.name for path in BAGS.glob("*/*.mcap"))
REDUCED = (
    "tracks swapped",
    "left track backwards",
    "gyro sign",
    "gyro in deg/s",
    "x and y",
    "diameter for radius",
)
HEALTHY_FROM = {"warthog": 129.0}  # s; before, its reference is stuck or late
LEAST_SHARE = 0.95  # of mistakes for which a log has enough motion


@cache
def robot(name: str) -> Log:
    """The log of a robot; the test is skipped without it."""
    file = name.removesuffix("_gnss")
    if not is_present(file):
        pytest.skip("the log is not in ../shared/data")
    table = np.genfromtxt(FOLDER / FILES[file], delimiter=",", names=True)
    if file == "mower":
        return _mower(table, receiver=name == "mower_gnss")
    return _marmotte(table) if file == "marmotte" else _warthog(table)


@cache
def recorded(name: str) -> Log:
    return log_of_bag(BAGS / name)


def emulated(vehicle: str, folder: Path) -> Log:
    """A field trial of some minutes, with the emulated sensors of the vehicle."""
    p = load_emulator_parameters({"vehicle": vehicle, "scenario": "field_trial", "seed": 3})
    record_drive(p, simulate_drive(p), folder / vehicle)
    return log_of_bag(folder / vehicle)


def log_of_bag(path: Path) -> Log:
    with open_bag(path, None) as bag:
        p = parameters_of(bag, [], [])
        stream, collector = InputStream(bag, p, InputFilters()), Collector(p, load_soil_parameters().watch)
        for batch in stream:
            collector.add(batch.rows, stream.sources)
        log = collector.log()
    assert log is not None
    return log


def _first_rows(index: FloatArray) -> FloatArray:
    """Indices of the rows at which ``index`` has a new value."""
    return np.concatenate(([0], np.flatnonzero(np.diff(index)) + 1))


def _tracks(t: FloatArray, left: FloatArray, right: FloatArray) -> Tracks:
    return tracks_of_speeds(t, np.column_stack((left, right)))


def _one_axis(t: FloatArray, rate: FloatArray, force: FloatArray | None = None) -> Gyro:
    unknown = np.full(len(t), np.nan)
    forces = np.full((len(t), 3), np.nan) if force is None else force
    return Gyro("imu/data_raw", t, np.column_stack((unknown, unknown, rate)), forces)


def _marmotte(log: FloatArray) -> Log:
    t, new = log["t"], _first_rows(log["idx"])
    late = t[new] - 0.25
    gyro = _one_axis(t, log["gz"], np.column_stack([log[name] for name in ("ax", "ay", "az")]))
    places = np.column_stack((log["x"], log["y"]))[new]
    fixes = Fixes("reference_pose", late, places, np.full(len(new), 0.02))
    compass = Compass("reference_pose", late, log["yaw"][new], is_used=False)
    return Log(
        Machine(0.1167, 0.52, 0.6), _tracks(t, log["left"], log["right"]), (gyro,), (fixes,), (compass,)
    )


def _warthog(log: FloatArray) -> Log:
    t, new = log["t"], _first_rows(log["icp_index"])
    rates = np.column_stack([log[f"imu_{axis}"] for axis in "xyz"])
    forces = np.column_stack([log[f"imu_acceleration_{axis}"] for axis in "xyz"])
    places = np.column_stack((log["icp_pos_x"], log["icp_pos_y"]))[new]
    fixes = Fixes("reference_pose", t[new] - 0.4, places, np.full(len(new), 0.02))
    compass = Compass("reference_pose", t[new] - 0.4, log["icp_yaw"][new], is_used=False)
    tracks = _tracks(t - 0.15, log["meas_left_vel"], log["meas_right_vel"])
    return Log(
        Machine(0.3, 1.08, 0.914), tracks, (Gyro("imu/data_raw", t, rates, forces),), (fixes,), (compass,)
    )


def _mower(log: FloatArray, *, receiver: bool) -> Log:
    t, v, rate, radius, tread = log["t"], log["v"], log["gz"], 0.2, 1.0
    tracks = _tracks(t, (v - rate * tread / 2.0) / radius, (v + rate * tread / 2.0) / radius)
    new = _first_rows(log["gnss_index"]) if receiver else np.arange(len(t))
    names = ("x_gnss", "y_gnss") if receiver else ("x", "y")
    places = np.column_stack([log[name] for name in names])[new]
    fixes = Fixes("gnss_pose", t[new], places, np.full(len(new), 0.9 if receiver else 0.02))
    return Log(Machine(radius, tread, 0.5), tracks, (_one_axis(t, rate),), (fixes,))


ROBOTS = ("marmotte", "warthog", "mower", "mower_gnss")


def _has(log: Log, mistake: Mistake) -> bool:
    """Whether the log has the columns that the mistake changes."""
    if mistake.needs in ("heading", "courses"):
        return bool(log.compasses)
    if mistake.needs in ("rates", "gravity", "starts"):
        return bool(np.isfinite(log.gyros[0].rates).all())
    return True


def _outcome(log: Log, name: str) -> str:
    mistake = MISTAKES[name]
    result = check(mistake.inject(log))
    causes = {cause.cause for cause in result.causes}
    if not causes:
        return "undetermined" if result.undetermined else "silent"
    return "named" if causes <= {mistake.cause, *mistake.also} else f"false: {', '.join(sorted(causes))}"


@pytest.mark.parametrize("name", ROBOTS)
def test_no_cause_is_found_in_a_healthy_log_of_a_robot(name: str) -> None:
    assert check(robot(name)).causes == ()


def test_a_reference_that_stalls_and_leaps_is_not_called_late() -> None:
    log = piece(robot("warthog"), 60.0, 180.0)
    assert check(log).causes == ()
    assert check(VARIANTS["no heading"](log)).causes == ()


@pytest.mark.parametrize("name", RUNS)
def test_no_cause_is_found_in_a_recorded_run(name: str) -> None:
    assert check(recorded(name)).causes == ()


@pytest.mark.parametrize("name", ["marmotte", "warthog"])
def test_mistakes_in_a_log_of_a_robot_are_named(name: str) -> None:
    log = robot(name)
    assert {mistake: _outcome(log, mistake) for mistake in REDUCED} == dict.fromkeys(REDUCED, "named")


@pytest.mark.parametrize("mistake", ["tracks swapped", "gyro sign", "gyro in deg/s", "left track backwards"])
def test_mistakes_in_the_slalom_are_named(mistake: str) -> None:
    assert _outcome(recorded("slalom_sand"), mistake) == "named"


def _check_matrix(name: str, log: Log) -> dict[str, str]:
    outcomes = {m: _outcome(log, m) for m, mistake in MISTAKES.items() if _has(log, mistake)}
    for outcome in ("named", "undetermined", "silent", "false"):
        names = [mistake for mistake, one in outcomes.items() if one.startswith(outcome)]
        print(f"{name}: {outcome} {len(names)}" + (f": {', '.join(names)}" if outcome != "named" else ""))
    assert not [f"{mistake}: {one}" for mistake, one in outcomes.items() if one.startswith("false")]
    return outcomes


def assert_most_named(log: Log, outcomes: dict[str, str]) -> None:
    """Assert that most mistakes are named for which the log has enough motion."""
    observable = [name for name in outcomes if name not in AMBIGUOUS and holds(log, MISTAKES[name].needs)]
    unnamed = [name for name in observable if outcomes[name] != "named"]
    print(f"  least motion for {len(observable)}, not named of these: {', '.join(unnamed) or 'none'}")
    assert len(unnamed) <= (1.0 - LEAST_SHARE) * len(observable)


@pytest.mark.slow
@pytest.mark.parametrize("span", [(0.0, 60.0), (60.0, 150.0), (60.0, 180.0)])
@pytest.mark.parametrize("name", ROBOTS)
def test_no_cause_is_found_in_a_healthy_variant_of_a_piece(name: str, span: tuple[float, float]) -> None:
    start = HEALTHY_FROM.get(name, 0.0)
    log = piece(robot(name), start + span[0], start + span[1])
    results = {variant: check(change(log)) for variant, change in VARIANTS.items()}
    assert {variant: result.causes for variant, result in results.items() if result.causes} == {}


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_no_mistake_in_a_log_of_a_robot_is_called_another(name: str) -> None:
    outcomes = _check_matrix(name, robot(name))
    if name != "mower_gnss":  # errors of metres hide delays and gears
        assert_most_named(robot(name), outcomes)


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_no_mistake_in_a_recorded_run_is_called_another(name: str) -> None:
    assert_most_named(recorded(name), _check_matrix(name, recorded(name)))


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", VEHICLES)
def test_no_mistake_in_an_emulated_drive_is_called_another(vehicle: str, tmp_path: Path) -> None:
    log = emulated(vehicle, tmp_path)
    assert check(log).causes == ()
    assert_most_named(log, _check_matrix(vehicle, log))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["marmotte", "warthog", "mower"])
def test_of_two_mistakes_on_a_robot_one_is_named_and_nothing_else_in_four_of_five(name: str) -> None:
    log, random = robot(name), np.random.default_rng(0)
    observable = sorted(m for m in MISTAKES.keys() - AMBIGUOUS if holds(log, MISTAKES[m].needs))
    pairs = [[MISTAKES[m] for m in random.choice(observable, 2, replace=False)] for _ in range(60)]
    named = 0
    for first, second in pairs:
        causes = {cause.cause for cause in check(second.inject(first.inject(log))).causes}
        named += bool(causes) and causes <= {first.cause, *first.also, second.cause, *second.also}
    assert named >= 0.8 * len(pairs)
