# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Bags with hostile messages: contents, stamps, types, missing topics, parameters and vehicles.

Each family yields names, and functions that make the bag; ``hostile_containers.py`` has the others.
"""

import dataclasses
import io
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import redirect_stdout
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import yaml
from fixtures.made_bags import TEXT

from trackslip_bags.messages import deserialize, header, make, serialize
from trackslip_bags.reader import open_bag
from trackslip_bags.writer import BagWriter
from trackslip_common.config_files import config_directory, parameters_text
from trackslip_common.parameters import flat_fields, to_flat
from trackslip_common.topics import DIAGNOSTICS, TOPICS
from trackslip_common.vehicle_files import load_vehicle, vehicle_text
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, load_slip_parameters
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_tools.cli.main import main

LAST_S = 7.0  # s, of the valid recording: a straight, and turns
# topics of which few messages suffice
_THINNED = ("/truth/", "/odometry", "/track_slip", "/machine_state", "/attitude", "/imu/mag")
_S = 1_000_000_000
_BAG = Path(__file__).resolve().parents[2] / "bags" / "slalom_sand"

Change: TypeAlias = Callable[[Any, int], None]  # changes a message in place; number on its topic
Made: TypeAlias = Callable[[Path], Path]  # writes a bag into a folder, and returns the path
Family: TypeAlias = Iterator[tuple[str, Made]]


class Line(NamedTuple):
    """A recorded message."""

    topic: str
    type_name: str
    raw: bytes
    log_ns: int


@cache
def good() -> tuple[Line, ...]:
    """A short recording with all live topics: sensors, estimates, reports, diagnostics, parameters."""
    with TemporaryDirectory(prefix="trackslip_hostile_") as folder:
        output = Path(folder) / "estimates"
        with redirect_stdout(io.StringIO()):
            main(["replay", str(_BAG), "--stop", str(LAST_S), "--output", str(output)])
        lines = []
        for path in (_BAG, output):
            with open_bag(path) as bag:
                stop_ns = bag.start_ns + round(LAST_S * 1e9)
                lines += [
                    Line(m.topic, m.type_name, m.raw, m.log_time_ns)
                    for m in bag.messages(None, None, stop_ns)
                ]
    begin_ns = min(line.log_ns for line in lines)
    soil = parameters_text(to_flat(load_soil_parameters()), "soil_estimator")
    lines.append(_text("/soil_estimator/parameters", soil, begin_ns))
    lines = [line for k, line in enumerate(lines) if not line.topic.startswith(_THINNED) or k % 7 == 0]
    topics_found = {line.topic for line in lines}
    if "/vehicle" not in topics_found:
        lines.append(_text("/vehicle", vehicle_text(load_vehicle()), begin_ns))
    for k in range(round(LAST_S)):
        values = [make("diagnostic_msgs/msg/KeyValue", key="rate", value=str(k))]
        status = make(
            "diagnostic_msgs/msg/DiagnosticStatus", level=k % 3, name="slip_estimator: x", values=values
        )
        stamped = header(begin_ns + k * _S, "")
        array = make(TOPICS[DIAGNOSTICS].type_name, header=stamped, status=[status])
        lines.append(Line("/diagnostics", array.__msgtype__, serialize(array), begin_ns + k * _S))
    return tuple(sorted(lines, key=lambda line: line.log_ns))


def _text(topic: str, text: str, log_ns: int) -> Line:
    return Line(topic, TEXT, serialize(make(TEXT, data=text)), log_ns)


def write(lines: Iterable[Line], folder: Path, name: str = "bag") -> Path:
    """Write a bag of the lines in their order."""
    with BagWriter(folder / name) as bag:
        for line in lines:
            bag.write(line.topic, line.type_name, line.raw, line.log_ns)
    return folder / name


@cache
def first() -> dict[str, Line]:
    """The first message of each topic of the valid recording."""
    return {line.topic: line for line in reversed(good())}


def topics() -> list[str]:
    """All topics of the valid recording."""
    return sorted(first())


@cache
def stamped_topics() -> list[str]:
    """Topics whose messages have a header."""
    return [topic for topic in topics() if hasattr(_message(first()[topic]), "header")]


def _message(line: Line) -> Any:
    """The message of a line, a new object."""
    return deserialize(line.raw, line.type_name)


def without(*names: str) -> Iterator[Line]:
    """The valid recording without some topics."""
    return (line for line in good() if line.topic not in names)


# --- contents

NUMBERS: dict[str, float] = {
    "nan": math.nan,
    "inf": math.inf,
    "minus_inf": -math.inf,
    "1e308": 1e308,
    "minus_1e308": -1e308,
    "1e155": 1e155,
    "1e30": 1e30,
    "1e12": 1e12,
    "denormal": 5e-324,
    "minus_1": -1.0,
    "zero": 0.0,
}


def _changed(topic: str, change: Change, every: int, folder: Path) -> Path:
    """The valid recording with each ``every``-th message of a topic changed."""
    lines, number = [], 0
    for line in good():
        if line.topic == topic:
            if number % every == every // 2:
                line = _changed_line(line, change, number)
            number += 1
        lines.append(line)
    return write(lines, folder)


def _changed_line(line: Line, change: Change, k: int) -> Line:
    message = _message(line)
    change(message, k)
    return line._replace(raw=serialize(message))


def contents() -> Family:
    """All floats of a topic's messages: in one message of fifty, and in all of them."""
    for topic in stamped_topics():
        for name, value in NUMBERS.items():
            for every in (1, 50):
                change = partial(_set_numbers, value, "")
                yield f"contents{topic}={name} each {every}", partial(_changed, topic, change, every)


def fields() -> Family:
    """One field in all messages of a topic."""
    for topic in stamped_topics():
        for path, _, _ in _floats(_message(first()[topic])):
            for name in ("nan", "1e308", "1e30", "minus_1"):
                change = partial(_set_numbers, NUMBERS[name], path)
                yield f"field{topic}{path}={name}", partial(_changed, topic, change, 1)


def _set_numbers(value: float, only: str, message: Any, _: int) -> None:
    """Set every float of a message, nested ones too, or the one at a path; in 32 bits it may be infinite."""
    with np.errstate(over="ignore"):
        if message.__msgtype__ == "sensor_msgs/msg/LaserScan":  # of float32
            value = float(np.float32(value))
        for path, part, name in _floats(message):
            if only in ("", path):
                old = getattr(part, name)
                setattr(part, name, value if isinstance(old, float) else np.full_like(old, value))


def _floats(message: Any, at: str = "") -> Iterator[tuple[str, Any, str]]:
    """Path, message that has it, and name of each field of floats."""
    for field in dataclasses.fields(message):
        path, value = f"{at}.{field.name}", getattr(message, field.name)
        if dataclasses.is_dataclass(value) and field.name != "stamp":
            yield from _floats(value, path)
        elif isinstance(value, float) or (isinstance(value, np.ndarray) and value.dtype.kind == "f"):
            yield path, message, field.name


# --- stamps

_STAMPS: dict[str, Callable[[int, int, int], tuple[int, int]]] = {
    "zero": lambda _s, _ns, _k: (0, 0),
    "least": lambda _s, _ns, _k: (-(2**31), 0),
    "most": lambda _s, _ns, _k: (2**31 - 1, 999_999_999),
    "negative": lambda s, ns, _k: (-s - 1, ns),
    "before_1970": lambda s, ns, _k: (s - 2_000_000_000, ns),
    "in_2060": lambda s, ns, _k: (min(s + 1_100_000_000, 2**31 - 1), ns),
    "nanosec_beyond": lambda s, _ns, _k: (s, 2**32 - 1),
    "one_for_all": lambda _s, _ns, _k: (1_700_000_000, 5),
    "backwards": lambda s, ns, _k: (3_400_000_000 - s if s > 1_700_000_000 else 20 - s, 999_999_999 - ns),
    "in_turn": lambda s, ns, k: ((s, ns), (-(2**31), 0), (2**31 - 1, 0))[k % 3],
    "a_day_later": lambda s, ns, _k: (s + 86400, ns),
    "truncated": lambda s, _ns, _k: (s, 0),
}


def stamps() -> Family:
    """Stamps of a topic, in one message of fifty or all; and of all topics together."""
    for name, convert in _STAMPS.items():
        change = partial(_set_stamp, convert)
        for topic in stamped_topics():
            for every in (1, 50):
                yield f"stamps{topic}={name} each {every}", partial(_changed, topic, change, every)
        yield f"stamps={name}", partial(_changed_together, change)


def _set_stamp(convert: Callable[[int, int, int], tuple[int, int]], message: Any, k: int) -> None:
    stamp = message.header.stamp
    sec, nanosec = convert(int(stamp.sec), int(stamp.nanosec), k)
    stamp.sec, stamp.nanosec = max(-(2**31), min(sec, 2**31 - 1)), nanosec


def _changed_together(change: Change, folder: Path) -> Path:
    stamped = set(stamped_topics())
    lines = enumerate(good())
    return write((_changed_line(m, change, k) if m.topic in stamped else m for k, m in lines), folder)


def log_times() -> Family:
    """Log times; the stamps stay."""
    lines = good()
    begin = lines[0].log_ns
    variants: dict[str, Callable[[int, int], int]] = {
        "zero": lambda _, __: 0,
        "one_for_all": lambda _, __: begin,
        "backwards": lambda t, _: 2 * begin + 20 * _S - t,
        "latest": lambda t, _: 2**63 - 1 - 20 * _S + t - begin,
        "beyond_signed": lambda t, k: 2**64 - 1 if k == 50 else t,
        "all_beyond_signed": lambda t, _: 2**63 + t - begin,
        "a_century_between": lambda t, k: t + 100 * 365 * 86400 * _S * (k > 500),
        "first_at_zero": lambda t, k: 0 if k == 0 else t,
        "last_in_2262": lambda t, k: 2**63 - 1 if k == len(lines) - 1 else t,
        "at_random": lambda t, k: begin + (t - begin) * 7919 * (k + 1) % (20 * _S),
    }
    for name, variant in variants.items():
        yield f"log_times={name}", partial(_with_log_times, variant)


def _with_log_times(variant: Callable[[int, int], int], folder: Path) -> Path:
    lines = enumerate(good())
    return write((line._replace(log_ns=variant(line.log_ns, k)) for k, line in lines), folder)


# --- lists, texts, bytes


def sequences() -> Family:
    """Lists in messages: empty, truncated, too long; unusual texts."""
    long_name = "x" * 200_000
    for topic in (topic for topic in topics() if _type(topic) == "sensor_msgs/msg/JointState"):
        for name, count in (("none", 0), ("one", 1), ("three", 3), ("many", 5000)):
            for what, field in (("positions", "position"), ("velocities", "velocity"), ("names", "name")):
                change = partial(_resize, field, count)
                for every in (1, 3):
                    bag = f"sequences{topic}={what} {name} each {every}"
                    yield bag, partial(_changed, topic, change, every)
        yield f"sequences{topic}=one name twice", partial(_changed, topic, _one_name_twice, 1)
    frames = {"long": long_name, "steering": "\x1b[2J\0\n\u2028", "empty": "", "map": "map"}
    for topic in stamped_topics():
        for name, text in frames.items():
            every = 40 if text == long_name else 1
            yield f"frames{topic}={name}", partial(_changed, topic, partial(_frame, text), every)
    for name, count in {"none": 0, "one": 1, "many": 100_000}.items():
        yield f"scan=ranges {name}", partial(_changed, "/scan", partial(_ranges, count), 20)
    for name, value in NUMBERS.items():
        yield f"scan=angles {name}", partial(_changed, "/scan", partial(_angles, value), 1)
    texts = {"words": "x: y", "long": long_name, "steering": "\x1b[2J", "digits": "9" * 4000}
    for name, text in texts.items():
        yield f"diagnostics={name}", partial(_changed, "/diagnostics", partial(_statuses, text), 1)


def _resize(field: str, count: int, message: Any, _: int) -> None:
    values = getattr(message, field)
    is_text = field == "name"
    setattr(message, field, (list(values) * count)[:count] if is_text else np.resize(values, count))


def _one_name_twice(message: Any, _: int) -> None:
    message.name = [message.name[0]] * len(message.name)


def _frame(text: str, message: Any, k: int) -> None:
    message.header.frame_id = text + str(k) * (text == "map")


def _ranges(count: int, message: Any, _: int) -> None:
    message.ranges = np.full(count, 3.0, np.float32)


def _angles(value: float, message: Any, _: int) -> None:
    with np.errstate(over="ignore"):
        message.angle_min = message.angle_increment = float(np.float32(value))


def _statuses(text: str, message: Any, _: int) -> None:
    for status in message.status:
        status.name = status.message = status.hardware_id = text
        status.values = [make("diagnostic_msgs/msg/KeyValue", key=text, value=text)] * 50
        status.level = -1  # 255 as a byte


def raw_bytes() -> Family:
    """Bytes that are no message of their type."""
    variants: dict[str, Callable[[bytes], bytes]] = {
        "empty": lambda _: b"",
        "header": lambda raw: raw[:4],
        "cut": lambda raw: raw[: len(raw) * 2 // 3],
        "longer": lambda raw: raw + bytes(64),
        "big_endian": lambda raw: b"\0\0\0\0" + raw[4:],
        "parameter_list": lambda raw: b"\0\3\0\0" + raw[4:],
        "no_cdr": lambda raw: b"\xff" * len(raw),
        "huge_lengths": lambda raw: raw[:12] + b"\xff\xff\xff\x7f" + raw[16:],
        "not_utf8": lambda raw: raw[:12] + (5).to_bytes(4, "little") + b"\xff\xfe\x80\x81\0" + raw[24:],
    }
    for topic in topics():
        for name, variant in variants.items():
            for every in (1, 7):
                yield f"bytes{topic}={name} each {every}", partial(_with_bytes, topic, variant, every)


def _with_bytes(topic: str, variant: Callable[[bytes], bytes], every: int, folder: Path) -> Path:
    of_topic = [line for line in good() if line.topic == topic][::every]
    chosen = set(map(id, of_topic))
    return write((m._replace(raw=variant(m.raw)) if id(m) in chosen else m for m in good()), folder)


# --- topics and types


def _type(topic: str) -> str:
    return first()[topic].type_name


def kinds() -> Family:
    """Every topic with messages of another type, beside the valid ones or instead."""
    begin_ns = good()[0].log_ns
    others: list[Any] = [make(TEXT, data="hello"), make(TEXT, data=""), make("sensor_msgs/msg/JointState")]
    others += [make("sensor_msgs/msg/LaserScan"), make("nav_msgs/msg/Odometry"), make("std_msgs/msg/Empty")]
    for topic in sorted({*(f"/{name}" for name in TOPICS), *topics(), "/reference_pose", "/tf_static"}):
        for other in others:
            message = Line(topic, other.__msgtype__, serialize(other), begin_ns)
            if topic in first() and _type(topic) == message.type_name:
                continue
            yield f"kinds{topic}={message.type_name}", partial(_with_others, message)


def _with_others(other: Line, folder: Path) -> Path:
    """The valid recording with ``other`` once a second instead of the topic's messages."""
    others = [other._replace(log_ns=other.log_ns + k * _S) for k in range(9)]
    return write([*others, *without(other.topic)], folder)


def absences() -> Family:
    """Topics that are missing, empty, alone, or have one message or two."""
    for topic in topics():
        for count in (0, 1, 2, 3):
            yield f"{count} of{topic}", partial(_few, topic, count)
        yield f"alone{topic}", partial(_alone, topic)
        yield f"empty{topic}", partial(_empty, topic)
    yield "nothing", partial(write, ())
    sample, fix = first()["/sprockets"], first()["/box_pose"]
    few = good()[:9]
    added: dict[str, Callable[[], Iterable[Line]]] = {
        "one sample": lambda: [sample],
        "one sample and fix": lambda: [sample, fix],
        "one sample a thousand times": lambda: [sample] * 1000,
        "all twice": lambda: (line for line in good() for _ in range(2)),
        "every hundredth": lambda: good()[::100],
        "long names": lambda: [*(line._replace(topic="/" + "x" * 60_000) for line in few), *good()],
        "names that steer": lambda: [
            *(line._replace(topic=f"/\x1b[2J\n{k}") for k, line in enumerate(few)),
            *good(),
        ],
        "relative names": lambda: (line._replace(topic=line.topic.lstrip("/")) for line in good()),
        "names in a namespace": lambda: (line._replace(topic=f"/a/b/c{line.topic}") for line in good()),
        "2000 topics": lambda: [*(sample._replace(topic=f"/t{k}") for k in range(2000)), *good()],
        "name of nothing": lambda: [sample._replace(topic=""), *good()],
    }
    for name, lines in added.items():
        yield f"topics={name}", partial(_written, lines)


def _written(lines: Callable[[], Iterable[Line]], folder: Path) -> Path:
    return write(lines(), folder)


def _few(topic: str, count: int, folder: Path) -> Path:
    of_topic = [line for line in good() if line.topic == topic][:count]
    return write(sorted([*of_topic, *without(topic)], key=lambda line: line.log_ns), folder)


def _alone(topic: str, folder: Path) -> Path:
    return write((line for line in good() if line.topic == topic), folder)


def _empty(topic: str, folder: Path) -> Path:
    """A topic without messages."""
    with BagWriter(folder / "bag") as bag:
        bag.add_topic(topic, _type(topic))
        for line in without(topic):
            bag.write(line.topic, line.type_name, line.raw, line.log_ns)
    return folder / "bag"


# --- parameters and vehicles

_SIZES = (1e-300, 1e-30, 1e-12, 1e-6, 1e-3, 1e3, 1e6, 1e12, 1e30, 1e300, -1.0, 0.0, math.nan, math.inf)
_OTHERS: tuple[Any, ...] = (True, None, "x", [], {}, [1.0], 10**400, "\x1b[2J", "x" * 100_000)


def vehicles() -> Family:
    """The vehicle of the bag with one changed value; ``test_files.py`` has texts that are no vehicle."""
    text = vehicle_text(load_vehicle())
    for name, value in to_flat(load_vehicle()).items():
        for size in _SIZES if isinstance(value, float) else _OTHERS:
            yield (
                f"vehicle.{name}={size!r:.40}",
                partial(_carrying, "/vehicle", _set(text, name.split("."), size)),
            )
    for name in ("tread", "rolling_radius", "contact_length"):
        kinematics = {"rolling_radius": 0.1, "tread": 0.7, "contact_length": 1.0} | {name: 1e-30}
        small = str(yaml.safe_dump({"name": "x", "kinematics": kinematics}))
        yield f"vehicle alone.{name}=1e-30", partial(_carrying, "/vehicle", small)
    small = "name: x\nkinematics: {rolling_radius: 1.0e-30, tread: 1.0e-30, contact_length: 1.0e-30}"
    yield "vehicle alone=1e-30", partial(_carrying, "/vehicle", small)
    for vehicle in sorted((config_directory() / "vehicles").glob("*.yaml")):
        other = vehicle_text(load_vehicle(vehicle.stem))
        yield f"vehicle is {vehicle.stem}", partial(_carrying, "/vehicle", other)


def parameters() -> Family:
    """Parameters of the bag, each at the ends of its range."""
    p = load_slip_parameters()
    low: dict[str, Any] = {}
    high: dict[str, Any] = {}
    for name, kind, spec in flat_fields(p):
        if name.startswith("vehicle."):
            continue
        values: list[Any] = list(spec.choices)
        if kind is float:
            lower = (1e-30 if spec.gt == 0.0 else spec.gt, spec.ge, -1e30)
            least = next(bound for bound in lower if bound is not None)
            most = next(bound for bound in (spec.le, spec.lt, 1e30) if bound is not None)
            values = [least, most]
            low[name], high[name] = least, most
        elif kind is bool:
            values = [True, False]
        elif not values:
            values = [0, -1, 2**62, "", "nothing", ["sprockets"], ["nothing"], []]
        for value in values:
            yield (
                f"parameters.{name}={value!r:.40}",
                partial(_carrying, "/slip_estimator/parameters", _parameters_with(p, {name: value})),
            )
    yield "parameters=all low", partial(_carrying, "/slip_estimator/parameters", _parameters_with(p, low))
    yield "parameters=all high", partial(_carrying, "/slip_estimator/parameters", _parameters_with(p, high))


def _parameters_with(p: SlipEstimatorParameters, values: dict[str, Any]) -> str:
    return parameters_text({**to_flat(p), **values}, "slip_estimator")


def _set(text: str, names: Sequence[str], value: Any) -> str:
    tree = yaml.safe_load(text)
    branch = tree
    for name in names[:-1]:
        branch = branch[name]
    branch[names[-1]] = value
    return str(yaml.safe_dump(tree))


def _carrying(topic: str, text: str, folder: Path) -> Path:
    """The valid recording with ``text`` on a topic."""
    return write([_text(topic, text, good()[0].log_ns), *without(topic)], folder)


FAMILIES_OF_MESSAGES: tuple[Callable[[], Family], ...] = (
    *(contents, fields, stamps, log_times, sequences, raw_bytes, kinds, absences, vehicles, parameters),
)
