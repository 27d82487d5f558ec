# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Names in the documents exist: links, files, make targets, commands with their options, parameters."""

import argparse
import importlib
import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
import yaml
from fixtures.documents import DOCUMENTS, ROOT, Document, Place

from trackslip_common.config_files import node_defaults
from trackslip_common.errors import InputError
from trackslip_tools.cli import main as cli
from trackslip_tools.cli.commands import installed_commands

MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
TARGETS = set(re.findall(r"^([a-z]+):", MAKEFILE, re.MULTILINE))
VARIABLES = set(re.findall(r"^([A-Z]+) \?=", MAKEFILE, re.MULTILINE))
ENTRY = re.compile(r'"(\w+) = \w+\.executables:\w+"')
OPTION = re.compile(r"--[a-z][a-z-]*")
PARAMETER = re.compile(
    r"\b([a-z_]+_(?:estimator|localizer|driver|adapter|imu|pls|gnss)|emulator)\.([a-z_]\w*(?:\.\w+)*)"
)
PATH = re.compile(r"(?:config|docs|tests|scripts|deploy|bags|src|requirements)/[\w./{},-]*\w")
QUOTED = re.compile(  # `parameter` (30 s …: a default; "(0.1 to" is a range
    r"`(?:[a-z_.<>]+\.)?([a-z_]+)`(?: \(| of )([0-9]+(?:\.[0-9]+)?)(?![\d.])"
    r"(?: ?(km|MiB))?(?! (?:to|or|and)\b|…)"
)
UNITS = {"": 1.0, "km": 1e3, "MiB": 2.0**20}
SUFFIXES = {"yaml", "py", "md", "launch", "msg"}
FOREIGN = frozenset(  # options of other programs that the documents mention
    [
        "--ros-args",
        "--params-file",
        "--enclave",
        "--user",
        "--compression-mode",
        "--symlink-install",
        "--signoff",
    ]
)


def nodes() -> set[str]:
    return {
        name
        for file in ROOT.glob("src/*/setup.py")
        for name in ENTRY.findall(file.read_text(encoding="utf-8"))
    }


def lines_of(program: str) -> Iterator[Place]:
    """Commands of a program in code blocks and code spans."""
    for file in DOCUMENTS:
        document = Document(file)
        for place in (*document.blocks, *document.spans()):
            text = re.sub(r"^\$ ", "", place.text)
            text = re.sub(r"^(\w+=\S+ )+", "", text)  # environment variables
            if text.startswith(f"{program} "):
                yield place._replace(text=text)


@cache
def options_of(command: str) -> frozenset[str]:
    parser = argparse.ArgumentParser()
    importlib.import_module(installed_commands()[command].module).add_arguments(parser)
    actions = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    parsers = [parser, *(inner for action in actions for inner in action.choices.values())]
    return frozenset(option for one in parsers for option in one._option_string_actions)


@cache
def parameters_of(node: str) -> frozenset[str]:
    """Dotted parameter names, and the names of their groups."""
    names = node_defaults(node, f"{node}.yaml")
    return frozenset(
        ".".join(parts[: n + 1]) for parts in (name.split(".") for name in names) for n in range(len(parts))
    )


@cache
def source_fields() -> frozenset[str]:
    text = (ROOT / "config/sources.yaml").read_text(encoding="utf-8")
    return frozenset(re.findall(r"^  (\w+):", text, re.MULTILINE))


def is_parameter(node: str, name: str) -> bool:
    parts = name.split(".")
    if node == "slip_estimator" and parts[0] == "sources":
        return len(parts) < 3 or parts[2] in source_fields()
    return name in parameters_of(node)


@pytest.mark.parametrize("file", DOCUMENTS, ids=lambda file: str(file.relative_to(ROOT)))
def test_links_lead_somewhere(file: Path) -> None:
    broken = []
    for link in Document(file).links():
        path, _, anchor = link.text.partition("#")
        if re.match(r"[a-z]+:", path):
            continue
        target = (file.parent / path).resolve() if path else file
        if not target.exists() or (anchor and anchor not in Document(target).anchors()):
            broken.append(str(link))
    assert broken == []


def test_a_broken_link_and_a_missing_anchor_are_seen() -> None:
    text = "# A title: here\n\n[a](#a-title-here) [b](#nowhere) `[c](none.md)`\n\n    [d](none.md)\n"
    document = Document(ROOT / "README.md", text)
    assert [link.text for link in document.links()] == ["#a-title-here", "#nowhere"]
    assert document.anchors() == {"a-title-here"}
    assert [place.text for place in document.blocks] == ["[d](none.md)"]


def test_files_that_are_named_are_there() -> None:
    missing = []
    for file in DOCUMENTS:
        for place in (*Document(file).spans(), *Document(file).blocks):
            for match in re.finditer(rf"(?<![\w/.-]){PATH.pattern}", place.text):
                alternatives = re.fullmatch(r"(.*)\{(.*)\}(.*)", match[0])
                head, names, tail = alternatives.groups() if alternatives else (match[0], "", "")
                for name in names.split(","):
                    if "NAME" not in match[0] and not (ROOT / f"{head}{name}{tail}").exists():
                        missing.append(str(place))
    assert missing == []


def test_targets_and_variables_of_make_are_there() -> None:
    unknown = []
    for place in lines_of("make"):
        for word in shlex.split(place.text, comments=True)[1:]:
            name, equals, _ = word.partition("=")
            if name not in (VARIABLES if equals else TARGETS):
                unknown.append(str(place))
    assert unknown == []


def test_commands_in_blocks_parse() -> None:
    refused = []
    for file in DOCUMENTS:
        for place in Document(file).blocks:
            if place.text.startswith("trackslip ") and "…" not in place.text:
                try:
                    cli.parse_arguments(shlex.split(place.text, comments=True)[1:])
                except InputError as error:
                    refused.append(f"{place}: {error}")
    assert refused == []


def test_commands_and_their_options_are_there() -> None:
    unknown = []
    for place in lines_of("trackslip"):
        words = re.split(r" #|[;|]", place.text)[0].split()
        command = re.sub(r"\W+$", "", words[1])
        if not command or command.startswith("-") or command == "COMMAND":
            continue
        if command not in installed_commands() or not set(OPTION.findall(" ".join(words[2:]))) <= options_of(
            command
        ) | {"--help"}:
            unknown.append(str(place))
    assert unknown == []


def test_options_named_alone_belong_to_a_command() -> None:
    known = (
        {option for command in installed_commands() for option in options_of(command)} | FOREIGN | {"--help"}
    )
    unknown = [
        str(place)
        for file in DOCUMENTS
        for place in Document(file).spans()
        if place.text.startswith("--") and place.text.split()[0].partition("=")[0] not in known
    ]
    assert unknown == []


def test_executables_and_launch_files_are_there() -> None:
    unknown = []
    for place in (*lines_of("ros2 run"), *lines_of("ros2 launch")):
        _, verb, package, name = place.text.split()[:4]
        if not package.startswith("trackslip_"):
            continue
        setup, launch = ROOT / "src" / package / "setup.py", ROOT / "src" / package / "launch" / name
        there = launch.is_file() if verb == "launch" else f'"{name} = ' in setup.read_text(encoding="utf-8")
        if not there:
            unknown.append(str(place))
    assert unknown == []


def test_parameters_are_there() -> None:
    """``node.parameter`` in any code, and ``-p parameter:=`` of a node."""
    unknown, known = [], nodes()
    for file in DOCUMENTS:
        for place in (*Document(file).blocks, *Document(file).spans()):
            for node, name in PARAMETER.findall(place.text):
                if node in known and name.split(".")[0] not in SUFFIXES and not is_parameter(node, name):
                    unknown.append(str(place))
    for place in lines_of("ros2 run"):
        node = place.text.split()[3]
        for name in re.findall(r"-p ([\w.]+):=", place.text):
            if name != "vehicle" and not is_parameter(node, name):
                unknown.append(str(place))
    assert unknown == []


@pytest.mark.parametrize(
    ("node", "name", "there"),
    [
        ("slip_estimator", "gate_probability", True),
        ("slip_estimator", "turning", True),
        ("slip_estimator", "sources.rtk.lever_arm_x", True),
        ("slip_estimator", "sources.rtk.lever_arm_q", False),
        ("slip_estimator", "gate_likelihood", False),
    ],
)
def test_parameter_names_are_recognised(node: str, name: str, there: bool) -> None:
    assert is_parameter(node, name) is there


def test_defaults_that_are_quoted_are_those_of_config() -> None:
    defaults = _defaults()
    quoted = [
        (file.name, name, float(number) * UNITS[unit])
        for file in DOCUMENTS
        for name, number, unit in QUOTED.findall(" ".join(file.read_text(encoding="utf-8").split()))
        if name in defaults
    ]
    assert len(quoted) >= 8
    assert [quote for quote in quoted if quote[2] not in defaults[quote[1]]] == []


def _defaults() -> dict[str, set[float]]:
    """Numbers in config/ by the last part of their parameter's name."""
    defaults: dict[str, set[float]] = {}
    for file in (ROOT / "config").glob("*.yaml"):
        trees = [yaml.safe_load(file.read_text(encoding="utf-8"))]
        while trees:
            for name, value in trees.pop().items():
                if isinstance(value, dict):
                    trees.append(value)
                elif isinstance(value, (int, float)):
                    defaults.setdefault(name, set()).add(float(value))
    return defaults


def test_each_document_is_on_the_map() -> None:
    text = (ROOT / "docs/README.md").read_text(encoding="utf-8")
    pages = {file.name for file in DOCUMENTS if file.parent.name == "docs"} - {"README.md"}
    assert [name for name in sorted(pages) if f"({name})" not in text] == []
