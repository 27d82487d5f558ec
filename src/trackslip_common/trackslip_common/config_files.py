# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Finds and reads the YAML files of ``config/``, which has all defaults."""

from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

import yaml

from trackslip_common.errors import InputError
from trackslip_common.parameters import Parameters, flatten, from_flat
from trackslip_common.yaml_text import MAX_CHARACTERS, parse_mapping

P = TypeVar("P", bound=Parameters)

ROS_PARAMETERS = ("use_sim_time", "start_type_description_service", "qos_overrides.")
"""Beginnings of the names of parameters that ROS declares for every node."""


def config_directory() -> Path:
    """``config/`` beside this module: in the checkout a link to the one at its root, else installed data."""
    return Path(str(files(__package__))) / "config"


def config_file(name: str) -> Path:
    """The path of a file in ``config/`` by its name, or of a file of the user by its path.

    Raises:
        InputError: there is no such file.
    """
    for candidate in (Path(name), config_directory() / name):
        if candidate.is_file():
            return candidate
    raise InputError(f"file '{name}' not found, here or in {config_directory()}")


def read_yaml(path: Path) -> dict[str, Any]:
    """Contents of a YAML file whose top level is a mapping.

    Raises:
        InputError: the file is missing, is not YAML, or has no mapping.
    """
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: no regular file; accepted: a YAML file")
    try:
        with path.open(encoding="utf-8") as file:
            text = file.read(MAX_CHARACTERS + 1)
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: no text in UTF-8; accepted: a YAML file in UTF-8") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error})") from error
    return parse_mapping(text, str(path))


def node_parameters(tree: Mapping[str, Any], node: str, where: str) -> dict[str, Any]:
    """A node's parameters in a ROS parameter file, as dotted names: its own section over ``/**``.

    Those that ROS itself declares are left out.

    Raises:
        InputError: a section is not in the form ``<node>: {ros__parameters: {…}}``, or in a namespace.
    """
    values: dict[str, Any] = {}
    sections = ("/**", "/*", f"/**/{node}", f"/*/{node}", f"/{node}", node)
    for section in (name for name in sections if name in tree):
        body = tree[section]
        if not isinstance(body, Mapping) or not isinstance(body.get("ros__parameters"), Mapping):
            raise InputError(f"{where}: section '{section}' has no 'ros__parameters' mapping")
        values |= flatten(body["ros__parameters"])
    for name, body in tree.items():
        is_nested = isinstance(body, Mapping) and node in body
        if name not in sections and (is_nested or str(name).endswith(f"/{node}")):
            raise InputError(f"{where}: section '{name}' is of a namespace; accepted: {node}, or /**")
    return {name: value for name, value in values.items() if not name.startswith(ROS_PARAMETERS)}


def node_defaults(node: str, *files: str) -> dict[str, Any]:
    """A node's parameters in these files of ``config/`` together, as dotted names."""
    values: dict[str, Any] = {}
    for name in files:
        path = config_file(name)
        values |= node_parameters(read_yaml(path), node, str(path))
    return values


def load_parameters(cls: type[P], node: str, files: Sequence[str], *layers: Mapping[str, Any]) -> P:
    """A parameter record from these files of ``config/``, with layers of dotted names over them.

    Raises:
        InputError: a name is unknown or a value is rejected.
    """
    values: dict[str, Any] = {}
    for layer in (node_defaults(node, *files), *layers):
        values = cls.overlay(values, layer)
    return from_flat(cls, values, node)


def unflatten(flat: Mapping[str, Any]) -> dict[str, Any]:
    """Dotted names as nested groups, in the form of a parameter file."""
    tree: dict[str, Any] = {}
    for name, value in flat.items():
        *groups, last = name.split(".")
        branch = tree
        for group in groups:
            branch = branch.setdefault(group, {})
        branch[last] = value
    return tree


def parameters_text(parameters: Mapping[str, Any], node: str, **beside: Any) -> str:
    """The YAML text for the topic ``<node>/parameters``; nested or dotted names, as in a parameter file.

    ``beside``: further inputs of the node's start, by name.
    """
    content = {"ros__parameters": dict(parameters), **beside}
    text: str = yaml.safe_dump({node: content}, sort_keys=False)
    return text
