# SPDX-License-Identifier: Apache-2.0
"""One emulated drive for all replay tests: made once, faster than real time, with a fixed seed."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trackslip_estimation.bags.reader import open_bag
from trackslip_estimation.measurements import Measurement, PoseFix, Sprockets, YawRate
from trackslip_estimation.replay.edits import Edits
from trackslip_estimation.replay.inputs import read_inputs
from trackslip_estimation.slip_parameters import load_slip_parameters
from trackslip_sim.offline import record_drive
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_sim.scenarios import parse_scenario
from trackslip_sim.truth.simulate import simulate

_LEGS = ((3.0, 0.0, 0.0), (6.0, 2.2, 2.2), (6.0, 1.2, 2.2), (5.0, 2.2, 2.2), (6.0, 2.2, 1.2), (8.0, 2.2, 2.2))
SCENARIO = {
    "name": "faults",
    "soil": "sandy_loam",
    "segments": [dict(zip(("duration", "left", "right"), leg, strict=True)) for leg in (*_LEGS, *_LEGS[2:4])],
}


@dataclass(frozen=True)
class Log:
    """Measurements in the order of their arrival, and the truth."""

    measurements: tuple[Measurement, ...]
    truth_ns: NDArray[np.int64]  # (n,)
    truth: NDArray[np.float64]  # (n, 3) x, y, heading (continuous)

    def true_pose(self, stamp_ns: int) -> NDArray[np.float64]:
        """(3,) at a stamp within the drive."""
        t = (self.truth_ns - self.truth_ns[0]) * 1e-9
        at = (stamp_ns - self.truth_ns[0]) * 1e-9
        return np.array([np.interp(at, t, column) for column in self.truth.T])


@pytest.fixture(scope="session")
def emulated_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Straight legs and turns to both sides on sandy loam, 46 s, after a start at rest."""
    path = tmp_path_factory.mktemp("emulated") / "bag"
    record_drive(load_emulator_parameters({"seed": 1}), simulate(parse_scenario(SCENARIO)), path)
    return path


@pytest.fixture(scope="session")
def log(emulated_bag: Path) -> Log:
    """That drive as the estimator would take it."""
    with open_bag(emulated_bag) as bag:
        inputs = read_inputs(bag, load_slip_parameters(), Edits(), ("truth/odometry",))
    kinds = (Sprockets, YawRate, PoseFix)
    given = (arrival.measurement for arrival in inputs.arrivals)
    truth = inputs.series["truth/odometry"]
    poses = truth.values[:, :3].copy()
    poses[:, 2] = np.unwrap(poses[:, 2])
    return Log(tuple(m for m in given if isinstance(m, kinds)), truth.stamps_ns, poses)
