# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Readers of files for ``hostile_files.py``: each with valid files, and the processing of one."""

import contextlib
import io
import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
from fixtures.whole_inputs import read_inputs

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import open_bag
from trackslip_common.config_files import config_directory, load_parameters
from trackslip_common.errors import InputError
from trackslip_common.tally import Tally
from trackslip_common.vehicle_files import load_vehicle, parse_vehicle, vehicle_text
from trackslip_drivers.can_parameters import DEFAULT_FILES, NODE, CanDriverParameters
from trackslip_drivers.protocols.can_frames import STANDARD_FLAG, FrameSet, load_frames
from trackslip_drivers.protocols.excavator_can import ExcavatorCan
from trackslip_estimation.box.heading_ambiguity import CERTAIN_WEIGHTS, Headings, SideEvidence
from trackslip_estimation.box.parameters import DEFAULT_FILES as BOX_FILES
from trackslip_estimation.box.parameters import NODE as BOX_NODE
from trackslip_estimation.box.parameters import BoxNodeParameters
from trackslip_estimation.box.track import LocalizerState, Track
from trackslip_estimation.box.track_file import TrackFile, track_text
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.learned import learned_context
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.state_file import CHECKSUM, StateFile, digest, state_text
from trackslip_sim.machine.faults import parse_fault
from trackslip_sim.study.slip.results import Row
from trackslip_sim.study.slip.study import SlipStudy
from trackslip_tools.cli.main import main
from trackslip_tools.report.verdict import load_limits
from trackslip_tools.result_cache import ResultCache
from trackslip_tools.tuning.plan import change_parameters, read_plan
from trackslip_tools.tuning.task import Score
from trackslip_tools.tuning.tuner import cost

ROOT = Path(__file__).resolve().parents[2]
BAG = ROOT / "bags" / "slalom_sand"


@dataclass(frozen=True)
class Reader:
    """``read`` returns the exit code of a command, or raises ``InputError`` where it is none."""

    seeds: Sequence[bytes]  # valid files: none may be rejected
    read: Callable[[Path], int | None]
    suffix: str = ".yaml"
    bombs: Sequence[bytes] = ()  # hostile files that are mutated like the seeds


def _config(pattern: str) -> list[bytes]:
    return [path.read_bytes() for path in sorted(config_directory().glob(pattern))]


def vehicle(_: Path) -> Reader:
    """A vehicle file, and its text on a topic of a bag."""

    def read(path: Path) -> None:
        loaded = load_vehicle(str(path))
        load_slip_parameters({"vehicle": str(path)})
        assert parse_vehicle(vehicle_text(loaded), "again") is not None

    return Reader(_config("vehicles/*.yaml"), read)


def scenario(folder: Path) -> Reader:
    """A scenario, simulated briefly with its sensors."""

    def read(path: Path) -> int:
        return run(folder, "simulate", "--duration", "0.3", "--scenario", str(path))

    return Reader(_config("scenarios/*.yaml"), read)


def terrain(folder: Path) -> Reader:
    """A terrain, driven on briefly."""

    def read(path: Path) -> int:
        options = ("--scenario", "straight", "--terrain", str(path))
        return run(folder, "simulate", "--duration", "0.3", *options)

    with contextlib.redirect_stdout(io.StringIO()):
        read(config_directory() / "terrains" / "hill.yaml")  # compiles the kernels
    return Reader(_config("terrains/*.yaml"), read)


def limits(_: Path) -> Reader:
    """The limits of a report."""

    def read(path: Path) -> None:
        load_limits([str(path)])

    return Reader(_config("report.yaml"), read)


def fault(_: Path) -> Reader:
    """The text on ``emulator/fault``."""

    def read(path: Path) -> None:
        parse_fault(path.read_text(encoding="utf-8", errors="replace"), 1.0)

    texts = (
        "{sensor: sick, kind: unplug, start: 2.0, duration: 3.0}",
        "{sensor: can, kind: bus_off, duration: 1}",
    )
    return Reader([text.encode() for text in texts], read)


def parameters(_: Path) -> Reader:
    """A ROS parameter file, as --params of a short replay."""
    compile_replay()
    names = ("slip_estimator.yaml", "soil_estimator.yaml", "gnss.yaml")
    seeds = [(config_directory() / name).read_bytes() for name in names]
    return Reader(seeds, lambda path: main(["replay", str(BAG), "--stop", "1", "--params", str(path)]))


def plan(_: Path) -> Reader:
    """A tune file, and the first steps of a search."""
    p = load_slip_parameters()

    def read(path: Path) -> None:
        loaded = read_plan(path)
        shares = loaded.shares(p)
        for share in (shares, np.zeros(shares.size), np.ones(shares.size)):
            change_parameters(p, loaded.values(share))

    return Reader(_config("tune.yaml"), read)


def roles(_: Path) -> Reader:
    """The roles of a CAN bus."""
    p = load_parameters(CanDriverParameters, NODE, DEFAULT_FILES)
    dbc = config_directory() / p.dbc_file

    def read(path: Path) -> None:
        _receive(FrameSet(dbc, path, p.vehicle), p)

    return Reader(_config("can_roles.yaml"), read)


def dbc(_: Path) -> Reader:
    """The DBC of a CAN bus."""
    p = load_parameters(CanDriverParameters, NODE, DEFAULT_FILES)
    assert load_frames(p).codecs
    contract = config_directory() / p.roles_file

    def read(path: Path) -> None:
        _receive(FrameSet(path, contract, p.vehicle), p)

    return Reader(_config("*.dbc"), read, ".dbc")


def _receive(frames: FrameSet, p: CanDriverParameters) -> None:
    """Decode random frames of each id, some of a wrong length."""
    draw, bus = random.Random(0), ExcavatorCan(p, frames, Tally())
    for k in range(6):
        for message in frames.by_name.values():
            flag = 0 if message.is_extended_frame else STANDARD_FLAG
            length = draw.choice((message.length, message.length, draw.randrange(65)))
            bus.receive(message.frame_id | flag, draw.randbytes(length), (100 + k) * 10_000_000)


def mapping(folder: Path) -> Reader:
    """The mapping of an import."""
    log = folder / "log.csv"
    log.write_bytes(LOG)

    def read(path: Path) -> int:
        return run(folder, "import", str(log), "--mapping", str(path))

    return Reader([MAPPING, MAPPING_OF_FIXES], read)


def table(folder: Path) -> Reader:
    """A CSV log."""
    seeds = [LOG, LOG.replace(b",", b";"), b"\xef\xbb\xbf" + LOG.replace(b"\n", b"\r\n")]
    return Reader(seeds, importing(folder, MAPPING.decode()), ".csv")


def importing(
    folder: Path, mapping: str, log: Callable[[Path], Path] = lambda path: path
) -> Callable[[Path], int]:
    """A function that imports a log made of the case, with ``mapping``."""
    (folder / "mapping.yaml").write_text(mapping, encoding="utf-8")

    def read(path: Path) -> int:
        return run(folder, "import", str(log(path)), "--mapping", str(folder / "mapping.yaml"))

    return read


MAPPING = b"""time: {column: t, unit: s}
start: 5.0
topics:
  sprockets:
    left_velocity: {column: l, unit: deg/s, scale: -1.0}
    right_velocity: {column: r, unit: rpm}
    new_when_changes: l
  reference_pose:
    x: {column: x, unit: m}
    y: {column: y, unit: cm}
    yaw: {column: h, unit: deg}
    stddev: {x: 0.1, y: 0.1, yaw: 0.1}
    time_offset: 0.1
    frame: odom
parameters: {history_window: 2.0}
"""
MAPPING_OF_FIXES = b"""topics:
  sprockets:
    file: lo*.csv
    time: {column: t, unit: ms}
    left_velocity: {column: l, unit: km/h}
    right_velocity: {column: r, unit: km/h}
  imu/data_raw:
    time: {column: t, unit: us}
    angular_velocity_z: {column: h, unit: deg/s}
    linear_acceleration_x: {column: y, unit: m/s^2}
    linear_acceleration_y: {column: y, unit: m/s^2}
    linear_acceleration_z: {column: y, unit: m/s^2}
  gnss_pose:
    time: {column: t, unit: s}
    latitude: {column: y, unit: deg}
    longitude: {column: x, unit: deg, scale: 0.00001}
    heading: {column: h, unit: deg}
    stddev: {x: {column: y, unit: m}, y: {column: y, unit: cm}, yaw: 0.01}
vehicle: excavator_20t
parameters:
  pose_sources: [gnss_pose]
  sources: {gnss_pose: {lever_arm_x: -1.2}}
"""
LOG = b"t,l,r,x,y,h\n" + b"".join(b"%.2f,%d,2e0,%d.5,7,-3e1\n" % (0.1 * k, k, 3 * k) for k in range(40))


def state(_: Path) -> Reader:
    """Learned states of the slip estimator; two in three have a valid checksum."""
    p = load_slip_parameters()
    estimator = SlipEstimator(p)
    with open_bag(BAG) as bag:
        inputs = read_inputs(bag, p, InputFilters(stop_s=10.0), ())
    estimator.process_records(inputs.measurements(estimator.sources))
    assert estimator.learned is not None
    text = state_text(estimator.learned, learned_context(p), 1.8e9)

    def read(path: Path) -> None:
        content = path.read_bytes()
        if len(content) % 3:
            body = content.decode("utf-8", "replace").rpartition(CHECKSUM)[0] or content.decode(
                "utf-8", "replace"
            )
            path.write_text(f"{body}{CHECKSUM}{digest(body)}\n", encoding="utf-8")
        file = StateFile(str(path))
        learned = file.read(learned_context(p))
        assert file.note.isprintable(), file.note
        if learned is not None:
            SlipEstimator(p, learned=learned)

    return Reader([text.encode()], read)


def track(_: Path) -> Reader:
    """The track that the box localizer keeps, and the search area that follows from it."""
    p = load_parameters(BoxNodeParameters, BOX_NODE, BOX_FILES)
    headings = Headings(CERTAIN_WEIGHTS, SideEvidence())
    started = Track.from_pose(10**18, np.array((1.0, 2.0, 0.3)), np.array((0.01, 0.01, 0.001)), headings, p)
    seed = track_text(LocalizerState(started.predict(10**18 + 10**9, p), 10**18 + 2 * 10**9)).encode()

    def read(path: Path) -> None:
        file = TrackFile(str(path))
        saved = file.read()
        if saved is None:
            raise InputError(file.failure)
        assert np.isfinite(saved.track.expectation(saved.scan_ns + 10**9, p).pose).all()

    return Reader([seed], read, ".json")


def journal(_: Path) -> Reader:
    """Scores of an interrupted search, and their use by the search."""
    score = Score(1.5, {"box_pose": 1.0}, {"box_pose": 3}, 0.1, math.nan, 2.0, -3.0)
    empty = Path("empty.jsonl")
    written = ResultCache(empty, Score, "--output")
    for k in range(4):
        written.add(str(k), score)
    seed = empty.read_bytes()

    def read(path: Path) -> None:
        reopened = ResultCache(path, Score, "--output")
        for one in reopened.values():
            for objective in ("likelihood", "pose", "position"):
                cost(objective, one)
        reopened.add("another", score)

    return Reader([seed], read, ".jsonl")


def cache(_: Path) -> Reader:
    """Finished parts of a study."""
    path = Path("cache.jsonl")
    examples: dict[Any, Any] = {str: "sand", int: 3, float: 0.5}
    row = Row(*(examples.get(kind, (0.1, 0.9)) for kind in get_type_hints(Row).values()))
    study, written = SlipStudy({}, ()), ResultCache(path, Row, "--cache")
    for k in range(3):
        written.add(str(k), row)
    seed = path.read_bytes()

    def read(path: Path) -> None:
        for piece in ResultCache(path, Row, "--cache").values():
            study.markdown([piece])

    return Reader([seed], read, ".jsonl")


def run(folder: Path, *words: str) -> int:
    """Exit code of a command that writes a bag, which is removed."""
    code = main([*words, "--output", str(folder / "bag")])
    remove(folder / "bag")
    return code


def compile_replay() -> None:
    """Compile by a first replay, which takes as long as ten hostile ones."""
    with contextlib.redirect_stdout(io.StringIO()):
        main(["replay", str(BAG), "--stop", "1"])


def remove(bag: Path) -> None:
    """Remove a bag if it exists."""
    for file in bag.iterdir() if bag.is_dir() else ():
        file.unlink()
    if bag.is_dir():
        bag.rmdir()


READERS_OF_TEXTS: dict[str, Callable[[Path], Reader]] = {
    made.__name__: made
    for made in (
        *(vehicle, scenario, terrain, limits, fault, parameters, plan, roles, dbc, mapping, table),
        *(state, track, journal, cache),
    )
}
