# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""How good the estimate is on drives like the demo's, without its processes: ``make bars`` prints a table.

Each drive is recorded faster than real time and replayed three times: as it is, with the laser silent for
half a minute, and with laser and gyro silent. What is withheld comes back at the end, unscored.

Errors are those of ``trackslip replay``, over the whole bag.

e       distance of the estimated position from the true one        m
e_φ     error of the heading                                        rad
e_i     error of the slip of each driven track, while turning       1
"""

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np

from trackslip_bags.input_filters import InputFilters, Withhold
from trackslip_bags.reader import Bag, open_bag
from trackslip_common.errors import ExitCode
from trackslip_common.topics import TRUE_ODOMETRY, TRUE_SLIP
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_sim.machine.excavator import drive
from trackslip_sim.machine.offline import record_drive
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_tools.replay.parts import Part
from trackslip_tools.replay.reckoning import Reckoning
from trackslip_tools.replay.result import Replay
from trackslip_tools.replay.run import replay
from trackslip_tools.replay.scoring import errors_of, moving_slips, path_of_series, slip_errors
from trackslip_tools.replay.series import Series, in_order, reduced, series_of

SOILS = ("sand", "sandy_loam", "clayey_soil", "dry_clay")
OUTAGE = 30.0  # s
UNEQUAL = 0.1  # of the faster track, by which the other is slower in a turn


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
    path = directory / f"{trial.scenario}_{soil}_{seed}"
    record_drive(emulated, drive(emulated), path)
    with open_bag(path) as bag:
        return _Comparison(bag, emulated.lead_in + trial.silent_from).accuracy()


class _Comparison:
    """One bag with its truth; the silence begins ``begin`` s after the bag."""

    def __init__(self, bag: Bag, begin: float) -> None:
        self._bag, self._silence = bag, (begin, begin + OUTAGE)
        self._p = load_slip_parameters()
        self._sprockets_alone = Reckoning(self._p.vehicle.kinematics, with_gyro=False)

    def accuracy(self) -> Accuracy:
        """All of them."""
        whole = replay(self._bag, self._p, InputFilters(), TRUE_ODOMETRY, None, self._reckon)
        score, blind = whole.scores["filter"], self._error_after_silence("box_pose", "imu/data_raw")
        assert score is not None
        assert score.heading is not None
        return Accuracy(
            score.position,
            score.heading,
            self._turn_slip(whole),
            self._error_after_silence("box_pose"),
            blind,
            blind / self._dead_reckoning_error(whole),
        )

    def _error_after_silence(self, *topics: str) -> float:
        """m, at the end of ``OUTAGE`` without these topics."""
        filters = InputFilters(withhold=tuple(Withhold(topic, *self._silence) for topic in topics))
        end = replay(self._bag, self._p, filters, TRUE_ODOMETRY).withheld[0].end
        assert end is not None
        return end

    def _turn_slip(self, whole: Replay) -> float:
        odometry, tread = whole.series[TRUE_ODOMETRY], self._p.vehicle.kinematics.tread
        true = moving_slips(odometry, whole.series[TRUE_SLIP], tread)
        at = np.searchsorted(odometry.stamps_ns, true.stamps_ns)
        v_x, turning = odometry["v_x"][at], odometry["yaw_rate"][at] * tread / 2.0
        ground = np.column_stack((v_x - turning, v_x + turning))
        tracks = np.nan_to_num(ground / (1.0 - true.columns("left_slip", "right_slip")))
        turns = np.abs(np.diff(tracks)[:, 0]) > UNEQUAL * np.abs(tracks).max(axis=1)
        estimates = in_order(whole.estimates)
        left, right = estimates["slips"][:, 0], estimates["slips"][:, 1]
        own = series_of(stamp_ns=estimates["stamp_ns"], left_slip=left, right_slip=right)
        return float(np.sqrt(np.mean(slip_errors(own, Series(true.rows[turns])) ** 2)))

    def _reckon(self, part: Part) -> None:
        """Let the sprockets alone drive on from the true pose at the silence's beginning."""
        true = reduced(part.tables[TRUE_ODOMETRY].rows) if TRUE_ODOMETRY in part.tables else None
        begin_ns = self._bag.start_ns + round(self._silence[0] * 1e9)
        self._sprockets_alone.add(part.arrivals, None if true is None else true[true["stamp_ns"] >= begin_ns])

    def _dead_reckoning_error(self, whole: Replay) -> float:
        """m, at the end of the silence."""
        path, _ = self._sprockets_alone.result()
        assert path is not None
        end_ns = self._bag.start_ns + round(self._silence[1] * 1e9)
        odometry = whole.series[TRUE_ODOMETRY]
        truth = path_of_series(Series(odometry.rows[odometry.stamps_ns <= end_ns]))
        return float(np.hypot(*errors_of(path, truth)[-1, :2]))


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


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print; returns the exit code."""
    parser = argparse.ArgumentParser(prog="make bars", description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=1, help="runs of each drive on each soil (default: 1)")
    args = parser.parse_args(argv)
    failed = False
    names = list(vars(LIMITS))
    print(header(names))
    print(f"{'limit':<26}" + "".join(f"{limit:>8.4f} " for limit in astuple(LIMITS)))
    for what, bars in table(args.seeds):
        exceeded = bars.exceeded()
        failed |= bool(exceeded)
        cells = (f"{getattr(bars, name):.4f}{'!' if name in exceeded else ' '}" for name in names)
        print(f"{what:<26}" + "".join(f"{cell:>9}" for cell in cells), flush=True)
    return ExitCode.FAILED if failed else ExitCode.DONE


if __name__ == "__main__":
    sys.exit(main())
