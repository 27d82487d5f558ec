# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Generates the reference pages of ``docs/`` from declarations: parameters, topics and messages, commands.

``make docs`` writes them; ``tests/docs/test_reference_pages.py`` compares them.
"""

import argparse
import importlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, get_args, get_origin

from trackslip_bags.recording import RecordParameters
from trackslip_common.config_files import config_file, node_defaults, read_yaml
from trackslip_common.parameter_spec import Spec
from trackslip_common.parameters import Parameters, flat_fields, flatten
from trackslip_common.topics import TOPICS, Topic
from trackslip_common.vehicle import VehicleParameters
from trackslip_drivers.can_parameters import CanDriverParameters
from trackslip_drivers.nmea_parameters import NmeaParameters
from trackslip_drivers.sick_parameters import SickParameters
from trackslip_drivers.watson_parameters import WatsonParameters
from trackslip_drivers.wheel_parameters import WheelParameters
from trackslip_estimation.box.parameters import BoxNodeParameters
from trackslip_estimation.gnss.parameters import GnssLocalizerParameters
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.sources import KINDS
from trackslip_estimation.soil.soil_parameters import SoilEstimatorParameters
from trackslip_sim.parameters import EmulatorParameters
from trackslip_tools.cli.commands import installed_commands
from trackslip_tools.live.parameters import LiveParameters

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "docs"
MESSAGES = ROOT / "src" / "trackslip_msgs" / "msg"
VEHICLE = "excavator_20t"


class Node(NamedTuple):
    """One kind of node: its parameters, and the files of ``config/`` with their defaults."""

    parameters: type[Parameters]
    files: tuple[str, ...]


NODES = {
    "slip_estimator": Node(SlipEstimatorParameters, ("slip_estimator.yaml",)),
    "soil_estimator": Node(SoilEstimatorParameters, ("soil_estimator.yaml",)),
    "gnss_localizer": Node(GnssLocalizerParameters, ("gnss_localizer.yaml",)),
    "box_localizer": Node(BoxNodeParameters, ("box_localizer.yaml", "site.yaml")),
    "can_driver": Node(CanDriverParameters, ("can_driver.yaml",)),
    "wheel_adapter": Node(WheelParameters, ("wheel_adapter.yaml",)),
    "nmea_gnss": Node(NmeaParameters, ("nmea_gnss.yaml",)),
    "watson_imu": Node(WatsonParameters, ("watson_imu.yaml",)),
    "sick_pls": Node(SickParameters, ("sick_pls.yaml",)),
    "record": Node(RecordParameters, ("record.yaml",)),
    "live": Node(LiveParameters, ("live.yaml",)),
    "emulator": Node(EmulatorParameters, ("emulator.yaml", "site.yaml")),
}


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> Iterator[str]:
    """Lines of a Markdown table; empty columns are omitted."""
    cells = [[cell.replace("|", "\\|") for cell in row] for row in (tuple(head), *rows)]
    columns = [n for n in range(len(cells[0])) if any(row[n] for row in cells[1:])]
    lines = ["| " + " | ".join(row[n] for n in columns) + " |" for row in cells]
    yield from (lines[0], "|---" * len(columns) + "|", *lines[1:], "")


def parameters_page() -> Iterator[str]:
    """The page of all parameters: of each node, each kind of source, and a vehicle."""
    yield from (
        "# Parameters",
        "",
        "Every parameter of every node, with its default in `config/`. Give others in a parameter file",
        "(`params_file:=mine.yaml`), by `-p` of `ros2 run`, or by `--set NODE.PARAMETER=VALUE` of",
        "`trackslip replay`. A value out of range is refused with one line. *live*: the parameter may change",
        "while the node runs. *basic*: states a machine or what is connected to it; all others are for",
        "experts. The vehicle, which `vehicle` names, has [a file](#vehicle-file).",
        "",
    )
    for name, node in NODES.items():
        yield from (f"## {name}", "")
        defaults = node_defaults(name, *node.files)
        node_fields = (
            (field, *rest)
            for field, *rest in flat_fields(node.parameters)
            if not field.startswith("vehicle.")
        )
        yield from _parameters(node_fields, defaults)
    yield from ("## Sources of the slip estimator", "")
    yield from (
        "Each topic in a list of sources has a group `sources.<name>`, named as the topic with `_` for `/`:",
        '`-p pose_sources:="[rtk]" -p sources.rtk.lever_arm_x:=0.3`.',
        "",
    )
    of_kinds = read_yaml(config_file("sources.yaml"))
    for kind, fields in KINDS.items():
        yield from (f"### {kind}", "")
        yield from _parameters(flat_fields(fields), of_kinds[kind])
    yield from ("## Vehicle file", "", f"Values are those of `config/vehicles/{VEHICLE}.yaml`.", "")
    values = flatten(read_yaml(config_file(f"vehicles/{VEHICLE}.yaml")))
    yield from _parameters(flat_fields(VehicleParameters), values)


def _parameters(fields: Iterable[Any], defaults: Mapping[str, Any]) -> Iterator[str]:
    own_first = sorted(fields, key=lambda field: "." in field[0])
    rows = [
        (
            f"`{name}`",
            _text(spec),
            _value(defaults.get(name)),
            spec.unit,
            _range(spec),
            _type(kind),
            _mark(spec),
        )
        for name, kind, spec in own_first
    ]
    yield from table(("parameter", "meaning", "default", "unit", "range", "type", "for"), rows)


def _mark(spec: Spec) -> str:
    """The mark "basic" if declared so; else empty, which stands for expert."""
    return "basic" if getattr(spec, "basic", False) else ""


def _type(kind: Any) -> str:
    if get_origin(kind) is tuple:
        return f"list of {_type(get_args(kind)[0])}"
    return str(getattr(kind, "__name__", kind)).replace(" | None", "")


def _value(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (list, tuple)):
        return ", ".join(_value(each) for each in value)
    return f"{value:g}" if isinstance(value, float) else f"`{value}`" if value != "" else "''"


def _range(spec: Spec) -> str:
    if not (spec.choices or _is_bounded(spec)):
        return ""
    return spec.accepted_range().removeprefix("one of ").removesuffix(spec.unit).strip()


def _is_bounded(spec: Spec) -> bool:
    return any(bound is not None for bound in (spec.gt, spec.ge, spec.lt, spec.le))


def _text(spec: Spec) -> str:
    return spec.description + ("" if spec.read_only else " (*live*)")


def topics_page() -> Iterator[str]:
    """The page of all topics, the services, and the fields of trackslip_msgs."""
    yield from (
        "# Topics, messages, services",
        "",
        "x points forward, y to the left, yaw counts counter-clockwise (REP-103). `base_link` is the",
        "track-contact centre. Delivery: *sensor* allows best effort; *reliable* delivers every message in",
        "order; *latched* also keeps the last one for later subscribers.",
        "",
        "## Topics",
        "",
    )
    rows = [
        (
            f"`{_full(name)}`",
            _types(topic),
            topic.publisher,
            topic.rate,
            topic.flow.value,
            topic.frame,
            topic.content,
        )
        for name, topic in TOPICS.items()
    ]
    yield from table(("topic", "type", "from", "rate", "delivery", "frame", "content"), rows)
    yield from (
        "`pose_sources` and the other lists of sources of the slip estimator name further inputs:",
        "[parameters](parameters.md#sources-of-the-slip-estimator).",
        "",
        "## Services",
        "",
    )
    yield from table(("service", "type", "does"), SERVICES)
    yield from ("## Messages of trackslip_msgs", "")
    for file in sorted(MESSAGES.glob("*.msg")):
        yield from _message(file)


SERVICES = (
    ("`slip_estimator/reset`", "std_srvs/srv/Trigger", "starts the estimate again; what was learned stays"),
    (
        "`slip_estimator/forget`",
        "std_srvs/srv/Trigger",
        "starts again with nothing learned, and deletes the state file",
    ),
    (
        "`slip_estimator/freeze`",
        "std_srvs/srv/SetBool",
        "true: poses are not used until it is called with false",
    ),
)


def _full(name: str) -> str:
    return f"/{name}" if name in ("tf", "diagnostics") else name


def _types(topic: Topic) -> str:
    return ", or ".join(each.replace("/msg/", "/") for each in (topic.type_name, *topic.others))


def _message(file: Path) -> Iterator[str]:
    """A message: comments at the head as text, constants and fields as tables."""
    yield from (f"### {file.stem}", "")
    lines = file.read_text(encoding="utf-8").splitlines()
    head = [line.lstrip("# ") for line in lines[: next(n for n, line in enumerate(lines) if line[:1] != "#")]]
    yield from (*filter(None, head), "")
    constants, fields = [], []
    for line in lines:
        code, _, comment = line.partition("#")
        words = code.split()
        if len(words) == 2 and "=" in words[1]:
            name, _, value = words[1].partition("=")
            constants.append((f"`{name}`", value, comment.strip()))
        elif len(words) == 2:
            fields.append((f"`{words[1]}`", words[0], comment.strip()))
    if constants:
        yield from table(("constant", "value", "meaning"), constants)
    yield from table(("field", "type", "unit and meaning"), fields)


def commands_page() -> Iterator[str]:
    """The page of commands: description, example and options of each."""
    yield from (
        "# Commands",
        "",
        "`trackslip COMMAND --help` prints the same. Exit codes: 0 done, 1 ran but failed its check, 2 bad",
        "input, 130 Ctrl-C. A command that takes a while shows a bar with the remaining time. An existing",
        "bag is refused before the work. JSON is written with `--json FILE` alone.",
        "",
    )
    for name, command in installed_commands().items():
        module = importlib.import_module(command.module)
        parser = argparse.ArgumentParser(prog=f"trackslip {name}", add_help=False)
        module.add_arguments(parser)
        yield from (f"## {name}", "", command.description, "", f"    {module.EXAMPLE}", "")
        yield from table(("argument", "meaning"), (_argument(action) for action in parser._actions))


def _argument(action: argparse.Action) -> tuple[str, str]:
    value = action.metavar or ("" if action.nargs == 0 else (action.dest or "").upper())
    value = " ".join(value) if isinstance(value, tuple) else value
    name = ", ".join(action.option_strings)
    text = (action.help or "") % {**vars(action), "prog": ""} if action.help else ""
    return f"`{' '.join(filter(None, (name, str(value))))}`", text


WRITTEN: Mapping[str, Callable[[], Iterator[str]]] = {
    "parameters.md": parameters_page,
    "topics.md": topics_page,
    "commands.md": commands_page,
}


def page(name: str) -> str:
    """The text of one page."""
    source = "<!-- Written by scripts/reference_pages.py (make docs) from the declarations. -->\n"
    return source + "\n".join(WRITTEN[name]()).rstrip() + "\n"


def main() -> None:
    """Write all pages."""
    for name in WRITTEN:
        (PAGES / name).write_text(page(name), encoding="utf-8")
        print(PAGES / name)


if __name__ == "__main__":
    main()
