# SPDX-License-Identifier: Apache-2.0
"""What replay tests share: an emulated drive, a small exact bag, and the ``trackslip`` command on them."""

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from trackslip_common.errors import ExitCode
from trackslip_common.topics import LEFT_SPROCKET, RIGHT_SPROCKET, TOPICS
from trackslip_estimation.bags.messages import header, make, serialize
from trackslip_estimation.bags.reader import open_bag
from trackslip_estimation.bags.writer import BagWriter
from trackslip_estimation.cli.main import main
from trackslip_estimation.conversions import in_six, planar_pose_message
from trackslip_estimation.measurements import Measurement, PoseFix, Sprockets, YawRate
from trackslip_estimation.replay.edits import Edits
from trackslip_estimation.replay.inputs import read_inputs
from trackslip_estimation.replay.run import replay
from trackslip_estimation.report.recording import read_recording
from trackslip_estimation.report.run import Run
from trackslip_estimation.slip_parameters import load_slip_parameters
from trackslip_sim.offline import record_drive
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_sim.scenarios import parse_scenario
from trackslip_sim.truth.simulate import simulate

MS = 1_000_000
EPOCH_NS = 1_700_000_000_000_000_000
POSE = TOPICS["box_pose"].type_name

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


@pytest.fixture(scope="session")
def run_over() -> Callable[..., Run]:
    """A function that replays a bag for a report; keyword arguments change parameters."""

    def replayed(path: Path, label: str = "a run", **values: Any) -> Run:
        p = load_slip_parameters(values)
        with open_bag(path) as bag:
            return Run(label, read_recording(bag, Edits()), p, Edits(), replay(bag, p, Edits(), None))

    return replayed


@pytest.fixture(scope="session")
def emulated_run(emulated_bag: Path, run_over: Callable[..., Run]) -> Run:
    """That drive as a report shows it, without the soil."""
    return run_over(emulated_bag)


class Line(NamedTuple):
    """One message for a bag."""

    log_ns: int
    topic: str
    type_name: str
    message: Any


def _message_of(m: Measurement) -> tuple[str, Any]:
    """(type, message) of a measurement, as the drivers send it."""
    stamp = header(EPOCH_NS + m.stamp_ns, "")
    if isinstance(m, Sprockets):
        kind, fields = (
            "sensor_msgs/msg/JointState",
            {
                "name": [LEFT_SPROCKET, RIGHT_SPROCKET],
                "position": list(m.positions or ()),
                "velocity": [m.left_speed, m.right_speed],
            },
        )
        return kind, make(kind, header=stamp, **fields)
    if isinstance(m, YawRate):
        kind = "sensor_msgs/msg/Imu"
        rate = make("geometry_msgs/msg/Vector3", z=m.rate)
        variances = [0.0] * 8 + [m.variance]
        return kind, make(kind, header=stamp, angular_velocity=rate, angular_velocity_covariance=variances)
    return POSE, _pose_message(m, stamp)


def _pose_message(m: PoseFix, stamp: Any) -> Any:
    pose = planar_pose_message(make, m.pose)
    inner = make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=in_six(m.covariance))
    return make(POSE, header=stamp, pose=inner)


@pytest.fixture(scope="session")
def write_bag() -> Callable[[Path, Iterable[Line]], Path]:
    """A function that writes lines into a bag, in the order of their log times."""
    return _write


def _write(path: Path, lines: Iterable[Line]) -> Path:
    with BagWriter(path) as bag:
        for line in sorted(lines, key=lambda line: line.log_ns):
            bag.write(f"/{line.topic}", line.type_name, serialize(line.message), line.log_ns)
    return path


@pytest.fixture(scope="session")
def lines(drive: Callable[..., Any]) -> list[Line]:
    """10 s with a turn; fixes arrive 0.3 s late, and the whole truth as ``reference_pose``."""
    segments = [
        (4.0, 2.0, 2.0, 0.02, 0.02, 0.0),
        (3.0, 1.0, 2.0, -0.1, 0.2, 0.0),
        (3.0, 2.0, 2.0, 0.02, 0.02, 0.0),
    ]
    driven = drive(segments, seed=1)
    found = []
    for m in driven.measurements:
        late_ns = 300 * MS if isinstance(m, PoseFix) else 2 * MS
        found.append(Line(EPOCH_NS + m.stamp_ns + late_ns, m.source, *_message_of(m)))
    for stamp_ns, truth in driven.truth.items():
        exact = PoseFix("reference_pose", stamp_ns, truth[:3], driven.measurements[1].covariance)
        found.append(Line(EPOCH_NS + stamp_ns + MS, "reference_pose", *_message_of(exact)))
    return found


@pytest.fixture(scope="session")
def bag(lines: list[Line], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _write(tmp_path_factory.mktemp("cli") / "bag", lines)


@pytest.fixture
def summary(tmp_path: Path) -> Callable[..., dict[str, Any]]:
    """A function that replays with these arguments and returns what ``--json`` holds."""

    def replay_to_json(*arguments: object, code: int = ExitCode.DONE) -> dict[str, Any]:
        out = tmp_path / "out.json"
        assert main(["replay", *map(str, arguments), "--json", str(out)]) == code
        found: dict[str, Any] = json.loads(out.read_text(encoding="utf-8"))
        return found

    return replay_to_json


@pytest.fixture
def refuse(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """A function that runs ``trackslip`` with bad arguments and returns its one line on stderr."""

    def error_of(*arguments: object) -> str:
        assert main([str(argument) for argument in arguments]) == ExitCode.BAD_INPUT
        error = capsys.readouterr().err
        assert error.endswith("\n")
        assert error.count("\n") == 1
        assert "Traceback" not in error
        return error

    return error_of
