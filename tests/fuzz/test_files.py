# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fuzz targets on files that a user hands over: bags, logs with mappings; ``InputError`` is fine."""

import contextlib
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from trackslip_bags.importing.importer import import_log
from trackslip_bags.importing.mapping import read_mapping
from trackslip_bags.messages import header, make, serialize
from trackslip_bags.parameters import bag_parameters
from trackslip_bags.reader import open_bag
from trackslip_bags.recovery.recover import recover
from trackslip_bags.writer import BagWriter
from trackslip_common.errors import InputError

Target = tuple[Callable[[bytes], None], list[bytes]]

MAPPING = b"""time: {column: t, unit: s}
start: 5.0
topics:
  sprockets:
    left_velocity: {column: l, unit: deg/s, scale: -1.0}
    right_velocity: {column: r, unit: rpm}
    new_when_changes: l
  reference_pose:
    x: {column: x, unit: m}
    y: {column: x, unit: cm}
    yaw: {column: l, unit: deg}
    stddev: {x: 0.1, y: 0.1, yaw: 0.1}
    time_offset: 0.1
    frame: odom
parameters: {history_window: 2.0}
"""
LOG = b't,l,r,x\n0.0,1,2,3\n0.1,"2",3,4\n0.2,-3e1,nan,inf\n'


def work_directory() -> Path:
    """In memory where the system has such a place; removed by whoever cleans it."""
    memory = Path("/dev/shm")
    return Path(tempfile.mkdtemp(prefix="trackslip_fuzz_", dir=memory if memory.is_dir() else None))


def bag_files() -> Target:
    """A bare MCAP or SQLite file of any content: opened, read through, each message decoded."""
    directory = work_directory()

    def one_input(data: bytes) -> None:
        for suffix in (".mcap", ".db3"):
            path = directory / f"bag{suffix}"
            path.write_bytes(data)
            with contextlib.suppress(InputError), open_bag(path) as bag:
                for message in bag.messages():
                    with contextlib.suppress(InputError):
                        bag.deserialize(message.raw, message.type_name)
                bag_parameters(bag)

    return one_input, [*_mcap_seeds(directory), b"SQLite format 3\0" + bytes(84)]


def _mcap_seeds(directory: Path) -> list[bytes]:
    """A small recording: whole, half, and without its end."""
    with BagWriter(directory / "seed") as bag:
        for n in range(3):
            joints = make("sensor_msgs/msg/JointState", header=header(n, "base_link"), position=[0.5])
            bag.write("/sprockets", "sensor_msgs/msg/JointState", serialize(joints), n * 400_000_000)
            text = make("std_msgs/msg/String", data="slip_estimator: {ros__parameters: {start: first_fix}}")
            bag.write("/slip_estimator/parameters", "std_msgs/msg/String", serialize(text), n * 400_000_000)
    whole = bag.file.read_bytes()
    return [whole, whole[: len(whole) // 2], whole[:-30]]


def recovered_bags() -> Target:
    """A damaged MCAP file: what is recovered of it opens undamaged, and nothing is left where nothing was."""
    directory = work_directory()
    damaged, output = directory / "bag.mcap", directory / "out"

    def one_input(data: bytes) -> None:
        damaged.write_bytes(data)
        with contextlib.suppress(InputError):
            recovery = recover(damaged, output)
            with open_bag(output) as bag:
                found = sum(1 for _ in bag.messages())
                if bag.damage or found != recovery.messages:
                    raise AssertionError(f"{recovery.messages} recovered, {found} there; {bag.damage}")
        shutil.rmtree(output, ignore_errors=True)

    return one_input, _mcap_seeds(directory)


def log_files() -> Target:
    """A mapping and a log, parted by a zero byte."""
    directory = work_directory()
    mapping, log, output = directory / "map.yaml", directory / "log.csv", directory / "bag"

    def one_input(data: bytes) -> None:
        first, _, second = data.partition(b"\0")
        mapping.write_bytes(first)
        log.write_bytes(second)
        with contextlib.suppress(InputError):
            import_log([log], read_mapping(mapping), output)
        shutil.rmtree(output, ignore_errors=True)

    return one_input, [MAPPING + b"\0" + LOG, MAPPING + b"\0" + LOG[:26], MAPPING + b"\0\xff\xfet"]


TARGETS = {target.__name__: target for target in (bag_files, recovered_bags, log_files)}
