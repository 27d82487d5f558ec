# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Message definitions: found, hashed as in ROS, and read as a bag defines them."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg

from trackslip_bags import messages, types
from trackslip_bags.definitions import installed_schema
from trackslip_bags.metadata import ROS2MSG, Schema
from trackslip_common.errors import InputError
from trackslip_common.topics import TOPICS

STANDARD = (
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/LaserScan",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "nav_msgs/msg/Odometry",
    "diagnostic_msgs/msg/DiagnosticArray",
)


@pytest.fixture(autouse=True)
def fresh_store() -> Iterator[None]:
    types.typestore.cache_clear()
    yield
    types.typestore.cache_clear()


def project_types() -> list[str]:
    folder = Path(__file__).parents[2] / "src" / "trackslip_msgs" / "msg"
    return sorted(f"trackslip_msgs/msg/{path.stem}" for path in folder.glob("*.msg"))


TYPES = sorted({*STANDARD, *project_types(), *(topic.type_name for topic in TOPICS.values())})


@pytest.mark.parametrize("type_name", TYPES)
def test_a_schema_defines_the_type_and_all_inside_it(type_name: str) -> None:
    defined = get_types_from_msg(types.known_schema(type_name).data.decode(), type_name)
    assert type_name in defined
    for name, definition in defined.items():
        assert definition[1] == types.typestore().fielddefs[name][1]


@pytest.mark.parametrize("type_name", TYPES)
def test_the_installed_definition_and_hash_are_those_of_rosbags(type_name: str) -> None:
    """The recorder writes the schemas of bags that are made without ROS."""
    installed = installed_schema(type_name)
    if installed is None:
        pytest.skip(f"{type_name} is not installed here")
    assert installed == types.known_schema(type_name)


def test_a_foreign_type_is_found_with_its_inner_types(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for package, name, text in (
        ("inner_msgs", "Wheel", "float64 speed\n"),
        (
            "outer_msgs",
            "Wheels",
            "# all of them\nstd_msgs/Header header\ninner_msgs/Wheel[] wheels\nTag tag\n",
        ),
        ("outer_msgs", "Tag", "string<=8 text\n"),
    ):
        folder = tmp_path / "share" / package / "msg"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.msg").write_text(text, encoding="utf-8")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    wheel = messages.make("inner_msgs/msg/Wheel", speed=2.5)
    message = messages.make(
        "outer_msgs/msg/Wheels", wheels=[wheel], tag=messages.make("outer_msgs/msg/Tag", text="a")
    )
    again = messages.deserialize(messages.serialize(message), "outer_msgs/msg/Wheels")
    assert again == message


@pytest.mark.parametrize("name", ["nowhere_msgs/msg/Nothing", "std_msgs/String", "../etc/passwd", ""])
def test_an_unknown_type_is_named(name: str) -> None:
    with pytest.raises(InputError) as caught:
        types.known_schema(name)
    assert f"'{name}'" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unreadable_definition_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "share" / "bad_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Bad.msg").write_text("float64 [[[\n", encoding="utf-8")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    with pytest.raises(InputError, match=r"Bad\.msg"):
        types.ensure_type("bad_msgs/msg/Bad")


def test_a_bag_with_an_older_definition_is_read_by_its_own() -> None:
    older = Schema(ROS2MSG, b"float64 left_slip\n")
    store = types.store_for("trackslip_msgs/msg/TrackSlip", older)
    raw = b"\x00\x01\x00\x00" + np.float64(0.5).tobytes()
    message: Any = store.deserialize_cdr(raw, "trackslip_msgs/msg/TrackSlip")
    assert message.left_slip == 0.5
    assert messages.make("trackslip_msgs/msg/TrackSlip").right_slip == 0.0


SEPARATOR = "\n" + "=" * 80 + "\nMSG: "
ENDLESS = {
    "holds itself": "sensor_msgs/JointState again",
    "holds itself in a list": f"a/E e{SEPARATOR}a/E\na/F[] f{SEPARATOR}a/F\na/E e",
    "an array of nothing": f"a/E[1000000000] e{SEPARATOR}a/E\n",
    "an array of arrays": f"a/E[2000] e{SEPARATOR}a/E\na/F[2000] f{SEPARATOR}a/F\nuint8 x",
}


@pytest.mark.parametrize("defect", ENDLESS)
def test_recursive_or_huge_definition_is_refused(defect: str) -> None:
    """Bags of a thousand bytes may contain such definitions."""
    definition = Schema(ROS2MSG, ENDLESS[defect].encode())
    with pytest.raises(ValueError, match=r"contains itself|too large"):
        types.store_for("sensor_msgs/msg/JointState", definition)


def test_a_bag_without_a_definition_is_read_by_that_of_this_process() -> None:
    assert types.store_for("sensor_msgs/msg/Imu", Schema("", b"")) is types.typestore()


def test_trailing_bytes_after_a_message_are_accepted() -> None:
    name = "sensor_msgs/msg/JointState"
    raw = messages.serialize(messages.make(name, velocity=[1.0, 2.0]))
    assert list(messages.deserialize(raw + b"\x07" * 8, name).velocity) == [1.0, 2.0]
    with pytest.raises(ValueError, match="more bytes"):
        messages.deserialize(raw + bytes(65), name)
    with pytest.raises(ValueError, match="no CDR header"):
        messages.deserialize(b"\x01" + raw, name)


def test_an_unknown_field_is_refused() -> None:
    with pytest.raises(TypeError):
        messages.make("std_msgs/msg/String", text="a")
