# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""How good the estimate is on drives like the demo's, without its processes: ``make bars`` prints a table.

Each drive is recorded faster than real time and replayed three times: as it is, with the laser silent for
half a minute, and with laser and gyro silent. What is withheld comes back at the end, unscored.

e       distance of the estimated position from the true one        m
e_φ     error of the heading                                        rad
e_i     error of the slip of each driven track, while turning       1
"""

import argparse
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trackslip_bags.input_filters import InputFilters, Withhold
from trackslip_bags.reader import Bag, open_bag
from trackslip_common.errors import ExitCode
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, load_slip_parameters
from trackslip_sim.machine.excavator import drive
from trackslip_sim.machine.offline import START_NS, record_drive
from trackslip_sim.parameters import EmulatorParameters, load_emulator_parameters
from trackslip_sim.truth.record import Truth
from trackslip_tools.replay.dead_reckoning import DrivenCollector, dead_reckon
from trackslip_tools.replay.result import Replay
from trackslip_tools.replay.run import replay
from trackslip_tools.replay.scoring import MOVING, in_order
from trackslip_tools.replay.whole_inputs import read_inputs

FloatArray = NDArray[np.float64]

SOILS = ("sand", "sandy_loam", "clayey_soil", "dry_clay")
OUTAGE = 30.0  # s
UNEQUAL = 0.1  # of the faster sprocket, by which the other is slower in a turn


@dataclass(frozen=True)
class Trial:
    """A drive, and when in it the sensors fall silent."""

    scenario: str
    duration: float  # s, the scenario repeated or cut
    silent_from: float  # s of the drive


# Each has turned to both sides before the silence, and turns during it.
TRIALS = (Trial("thesis", 80.0, 40.0), Trial("slalom", 60.0, 25.0), Trial("field_trial", 180.0, 90.0))


@dataclass(frozen=True)
class Accuracy:
    """Errors, each with its limit in ``LIMITS``."""

    position: float  # m, RMS of e
    heading: float  # rad, RMS of e_φ
    turn_slip: float  # RMS of e_i
    without_laser: float  # m, e after OUTAGE
    without_gyro: float  # m, the same, the gyro silent too
    of_dead_reckoning: float  # the same, over the error that the sprockets alone make from the true pose on

    def exceeded(self) -> list[str]:
        """Names of those beyond their limits."""
        return [name for name, limit in vars(LIMITS).items() if not getattr(self, name) <= limit]


LIMITS = Accuracy(0.03, 0.01, 0.04, 0.12, 0.3, 0.2)


def measure(trial: Trial, soil: str, seed: int, directory: Path) -> Accuracy:
    """Drive, record into ``directory``, replay, compare with the truth."""
    given = {"scenario": trial.scenario, "duration": trial.duration, "soil": soil, "seed": seed}
    emulated = load_emulator_parameters(given)
    truth = drive(emulated)
    path = directory / f"{trial.scenario}_{soil}_{seed}"
    record_drive(emulated, truth, path)
    with open_bag(path) as bag:
        return _Comparison(bag, emulated, truth).accuracy(trial)


class _Comparison:
    """One bag and its truth."""

    def __init__(self, bag: Bag, emulated: EmulatorParameters, truth: Truth) -> None:
        self._bag = bag
        self._truth = truth
        self._lead_in = emulated.lead_in
        self._p: SlipEstimatorParameters = load_slip_parameters()

    def accuracy(self, trial: Trial) -> Accuracy:
        """All of them."""
        whole, end = self._replay(()), trial.silent_from + OUTAGE
        begin = self._lead_in + trial.silent_from

        def lost(*topics: str) -> float:
            hidden = tuple(Withhold(topic, begin, begin + OUTAGE) for topic in topics)
            times, errors = self._errors(self._replay(hidden))
            return float(np.hypot(*errors[np.searchsorted(times, end, side="right") - 1, :2]))

        _, errors = self._errors(whole)
        blind = lost("box_pose", "imu/data_raw")
        return Accuracy(
            _rms(np.hypot(errors[:, 0], errors[:, 1])),
            _rms(errors[:, 2]),
            self._turn_slip(whole),
            lost("box_pose"),
            blind,
            blind / self._dead_reckoning_error(trial.silent_from, end),
        )

    def _replay(self, withheld: tuple[Withhold, ...]) -> Replay:
        return replay(self._bag, self._p, InputFilters(withhold=withheld), None)

    def _time(self, stamps_ns: NDArray[np.int64]) -> FloatArray:
        """Seconds of the drive."""
        return np.asarray((stamps_ns - START_NS) * 1e-9 - self._lead_in, dtype=np.float64)

    def _errors(self, result: Replay) -> tuple[FloatArray, FloatArray]:
        """(n,) times and (n, 3) errors of x, y, heading, at the estimates made during the drive."""
        estimates = in_order(result.estimates)
        times = self._time(estimates["stamp_ns"])
        driving = (times >= 0.0) & (times <= self._truth.duration)
        at = self._truth.interpolate(times[driving])
        errors = estimates["pose"][driving] - np.column_stack((at.x, at.y, at.yaw))
        errors[:, 2] = np.angle(np.exp(1j * errors[:, 2]))
        return times[driving], errors

    def _turn_slip(self, result: Replay) -> float:
        estimates = in_order(result.estimates)
        at = self._truth.interpolate(self._time(estimates["stamp_ns"]))
        p = self._p.vehicle.kinematics
        moving = np.abs(at.v_x) + np.abs(at.yaw_rate) * p.tread / 2.0 > MOVING
        speeds = np.column_stack((at.left_speed, at.right_speed))
        turning = np.abs(speeds[:, 1] - speeds[:, 0]) > UNEQUAL * np.abs(speeds).max(axis=1)
        driven = np.abs(speeds) * p.rolling_radius > MOVING
        scored = driven & (moving & turning)[:, np.newaxis]
        slips = estimates["slips"][:, :2]
        return _rms((slips - np.column_stack((at.left_slip, at.right_slip)))[scored])

    def _dead_reckoning_error(self, begin: float, end: float) -> float:
        """m, of driving by the sprockets alone from the true pose at ``begin`` to ``end``, s of the drive."""
        driven = DrivenCollector()
        driven.add(read_inputs(self._bag, self._p, InputFilters(), ()).rows)
        sprockets = driven.sprockets()
        assert sprockets is not None
        stamps = [START_NS + round((self._lead_in + t) * 1e9) for t in (begin, end)]
        start, goal = (self._truth.at(t) for t in (begin, end))
        pose = np.array((start.x[0], start.y[0], start.yaw[0]))
        path = dead_reckon(self._p.vehicle.kinematics, sprockets, stamps[0], pose)
        x, y, _ = path.at(np.array(stamps[1:], dtype=np.int64))[0]
        return float(np.hypot(x - goal.x[0], y - goal.y[0]))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def table(seeds: int) -> Iterator[tuple[str, Accuracy]]:
    """Drive, soil and seed; what they came to."""
    with tempfile.TemporaryDirectory(prefix="trackslip_bars_") as directory:
        for trial in TRIALS:
            for soil in SOILS:
                for seed in range(1, seeds + 1):
                    yield (
                        f"{trial.scenario:<12}{soil:<12}{seed:>2}",
                        measure(trial, soil, seed, Path(directory)),
                    )


def header(names: list[str]) -> str:
    """Two lines above the columns: the last word of each name in the second."""
    words = [name.removeprefix("of_").rpartition("_") for name in names]
    lines = ("".join(f"{word[k]:>8} " for word in words) for k in (0, 2))
    return "\n".join((" " * 26 + line).rstrip() for line in lines)


def main() -> int:
    """Measure and print; returns the exit code."""
    parser = argparse.ArgumentParser(prog="make bars", description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=1, help="runs of each drive on each soil (default: 1)")
    failed = False
    names = list(vars(LIMITS))
    print(header(names))
    print(f"{'limit':<26}" + "".join(f"{limit:>8.4f} " for limit in astuple(LIMITS)))
    for what, bars in table(parser.parse_args().seeds):
        exceeded = bars.exceeded()
        failed |= bool(exceeded)
        cells = (f"{getattr(bars, name):.4f}{'!' if name in exceeded else ' '}" for name in names)
        print(f"{what:<26}" + "".join(f"{cell:>9}" for cell in cells), flush=True)
    return ExitCode.FAILED if failed else ExitCode.DONE


if __name__ == "__main__":
    sys.exit(main())
