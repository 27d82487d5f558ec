# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Readers of bags for ``hostile_files.py``; part of each bag is hostile."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml
from mcap.writer import Writer
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore

from hostile_readers import BAG, Reader, importing, run
from trackslip_tools.cli.main import main

_TEXTS_FOR_METADATA = (
    *(b"", bytes(4096), b"# " + b"x" * 17_000_000, b"---\n" * 5000),
    b"rosbag2_bagfile_information:\n" + b"  - x\n" * 800_000,
    b"rosbag2_bagfile_information: &a {version: *a}",
    b"a: &a [x,x]\n" + b"".join(b"b%d: &b%d [*a,*a]\n" % (k, k) for k in range(20)),
)
_MAPPING = "topics: {sprockets: {from: /joint_states, left: [left], right: [right]}}\n"
_MSG = b"""std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_IDL = b"""================================================================================
IDL: sensor_msgs/msg/JointState
module sensor_msgs { module msg { struct JointState {
  std_msgs::msg::Header header; sequence<string> name;
  sequence<double> position; sequence<double> velocity; sequence<double> effort; }; }; };
================================================================================
IDL: std_msgs/msg/Header
module std_msgs { module msg { struct Header {
  builtin_interfaces::msg::Time stamp; string frame_id; }; }; };
================================================================================
IDL: builtin_interfaces/msg/Time
module builtin_interfaces { module msg { struct Time { int32 sec; uint32 nanosec; }; }; };
"""


def ros1(folder: Path) -> Reader:
    """A ROS 1 bag, with and without compressed chunks."""
    store, seeds = get_typestore(Stores.ROS1_NOETIC), []
    kinds = store.types
    for packed in (None, Ros1Writer.CompressionFormat.BZ2, Ros1Writer.CompressionFormat.LZ4):
        file = folder / "seed.bag"
        bag = Ros1Writer(file)
        if packed is not None:
            bag.set_compression(packed)
        with bag:
            joints = bag.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
            for k in range(4):
                stamp = kinds["builtin_interfaces/msg/Time"](sec=1000 + k, nanosec=0)
                header = kinds["std_msgs/msg/Header"](seq=k, stamp=stamp, frame_id="base_link")
                state = _state(kinds[joints.msgtype], header)
                bag.write(joints, (1000 + k) * 10**9, store.serialize_ros1(state, joints.msgtype))
        seeds.append(file.read_bytes())
        file.unlink()
    return Reader(seeds, importing(folder, _MAPPING), ".bag")


def metadata(folder: Path) -> Reader:
    """The metadata.yaml of a bag."""
    bag = folder / "recorded"
    bag.mkdir()
    for file in BAG.glob("*.mcap"):
        (bag / file.name).write_bytes(file.read_bytes())

    def read(path: Path) -> int:
        (bag / "metadata.yaml").write_bytes(path.read_bytes())
        return max(main(["info", str(bag)]), run(folder, "recover", str(bag)))

    seed = (BAG / "metadata.yaml").read_bytes()
    tree = yaml.safe_load(seed)
    information = tree["rosbag2_bagfile_information"]
    (name,) = information["relative_file_paths"]
    bombs = [*_TEXTS_FOR_METADATA]
    for paths in ([name] * 20_000, ["./" * k + name for k in range(200)], ["x/../" * 100 + name]):
        information["relative_file_paths"] = paths
        bombs.append(yaml.safe_dump(tree).encode())
    return Reader([seed], read, bombs=bombs)


def definition(folder: Path) -> Reader:
    """Type definitions in a bag, with messages of the types."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds, kind = store.types, "sensor_msgs/msg/JointState"
    header = kinds["std_msgs/msg/Header"](kinds["builtin_interfaces/msg/Time"](1000, 0), "base_link")
    raw = bytes(store.serialize_cdr(_state(kinds[kind], header), kind))

    def bag_of(path: Path) -> Path:
        file = folder / "defined.mcap"
        with file.open("wb") as stream:
            writer = Writer(stream)
            writer.start("ros2")
            text = path.read_bytes()
            schema = writer.register_schema(kind, "ros2idl" if b"module" in text else "ros2msg", text)
            channel = writer.register_channel("/joint_states", "cdr", schema)
            for k in range(3):
                writer.add_message(channel, k + 1, raw, k + 1)
            writer.finish()  # type: ignore[no-untyped-call]
        return file

    return Reader([_MSG, _IDL], importing(folder, _MAPPING, bag_of), ".msg")


def _state(kind: type, header: object) -> object:
    """One ``JointState`` of two sprockets."""
    values = np.array((0.5, 0.6))
    return kind(header=header, name=["left", "right"], position=values, velocity=values, effort=values)


READERS_OF_BAGS: dict[str, Callable[[Path], Reader]] = {
    made.__name__: made for made in (ros1, metadata, definition)
}
