# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Bags and logs of any content are read, recovered, imported, or rejected by ``InputError``."""

import contextlib
import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from hostile_readers import LOG, MAPPING
from trackslip_bags.importing.importer import import_log
from trackslip_bags.importing.mapping import read_mapping
from trackslip_bags.messages import header, make, serialize
from trackslip_bags.parameters import bag_parameters, bag_vehicle
from trackslip_bags.reader import open_bag
from trackslip_bags.recovery.recover import recover
from trackslip_bags.writer import BagWriter
from trackslip_common.config_files import parameters_text
from trackslip_common.errors import InputError
from trackslip_common.vehicle_files import load_vehicle, vehicle_text

Damage = tuple[float, int, bytes]  # position as a share of the file; bytes removed, bytes inserted

damages = st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(0, 64), st.binary(max_size=64)), max_size=4)
_ALL = settings().max_examples
of_folders = settings(  # files are slow; each replaces the one before
    max_examples=min(_ALL, max(_ALL // 50, 100)), suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The bytes of an MCAP file of three seconds."""
    with BagWriter(tmp_path_factory.mktemp("seed") / "bag") as bag:
        for n in range(3):
            joints = make("sensor_msgs/msg/JointState", header=header(n, "base_link"), position=[0.5])
            bag.write("/sprockets", "sensor_msgs/msg/JointState", serialize(joints), n * 400_000_000)
            text = make("std_msgs/msg/String", data="slip_estimator: {ros__parameters: {start: first_fix}}")
            bag.write("/slip_estimator/parameters", "std_msgs/msg/String", serialize(text), n * 400_000_000)
    return bag.file.read_bytes()


def damaged(content: bytes, damage: list[Damage]) -> bytes:
    for share, cut, put in damage:
        at = round(share * len(content))
        content = content[:at] + put + content[at + cut :]
    return content


@pytest.mark.parametrize("suffix", ["mcap", "db3"])
@of_folders
@given(damage=damages)
@example(damage=[(0.5, 1 << 20, b"")])
@example(damage=[(0.0, 1 << 20, b"SQLite format 3\0" + bytes(84))])
def test_bag_is_read_or_refused(suffix: str, damage: list[Damage], recording: bytes, tmp_path: Path) -> None:
    path = tmp_path / f"bag.{suffix}"
    path.write_bytes(damaged(recording, damage))
    with contextlib.suppress(InputError), open_bag(path) as bag:
        for message in bag.messages():
            with contextlib.suppress(InputError):
                bag.deserialize(message.raw, message.type_name)
        bag_parameters(bag)


@of_folders
@given(damage=damages)
@example(damage=[(0.0, 0, b"slip_estimator: 1\n")])
@example(damage=[(0.0, 1 << 20, b"slip_estimator: {ros__parameters: {vehicle: /etc/passwd}}")])
@pytest.mark.parametrize("topic", ["/slip_estimator/parameters", "/vehicle"])
def test_text_of_a_bag_is_read_or_refused(topic: str, damage: list[Damage], tmp_path: Path) -> None:
    """Parameters or a vehicle; of any text."""
    parameters = parameters_text({"start": "first_fix", "vehicle": "excavator_20t"}, "slip_estimator")
    text = parameters if "parameters" in topic else vehicle_text(load_vehicle())
    data = damaged(text.encode(), damage).decode("utf-8", "replace").replace("\0", "")
    shutil.rmtree(tmp_path / "bag", ignore_errors=True)
    with BagWriter(tmp_path / "bag") as bag:
        bag.write(topic, "std_msgs/msg/String", serialize(make("std_msgs/msg/String", data=data)), 0)
    with open_bag(tmp_path / "bag") as opened:
        for read in (bag_parameters, bag_vehicle):
            with contextlib.suppress(InputError):
                read(opened)


@of_folders
@given(damage=damages)
@example(damage=[])
@example(damage=[(0.5, 1 << 20, b"")])
def test_recovered_bag_is_whole(damage: list[Damage], recording: bytes, tmp_path: Path) -> None:
    path, output = tmp_path / "bag.mcap", tmp_path / "out"
    path.write_bytes(damaged(recording, damage))
    with contextlib.suppress(InputError):
        recovery = recover(path, output)
        with open_bag(output) as bag:
            assert sum(1 for _ in bag.messages()) == recovery.messages
            assert not bag.damage
    shutil.rmtree(output, ignore_errors=True)


def test_undamaged_log_is_imported(tmp_path: Path) -> None:
    mapping, log = tmp_path / "map.yaml", tmp_path / "log.csv"
    mapping.write_bytes(MAPPING)
    log.write_bytes(LOG)
    imported = import_log([log], read_mapping(mapping), tmp_path / "bag")
    assert imported.counts.items() >= {"/sprockets": 39, "/reference_pose": 40}.items()


@of_folders
@given(of_mapping=damages, of_log=damages)
@example(of_mapping=[], of_log=[(0.5, 1 << 20, b"")])
@example(of_mapping=[], of_log=[(0.0, 1 << 20, b"\xff\xfet")])
def test_log_is_imported_or_refused(of_mapping: list[Damage], of_log: list[Damage], tmp_path: Path) -> None:
    mapping, log, output = tmp_path / "map.yaml", tmp_path / "log.csv", tmp_path / "bag"
    mapping.write_bytes(damaged(MAPPING, of_mapping))
    log.write_bytes(damaged(LOG, of_log))
    with contextlib.suppress(InputError):
        import_log([log], read_mapping(mapping), output)
    shutil.rmtree(output, ignore_errors=True)
