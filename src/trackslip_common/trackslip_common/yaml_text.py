# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Reads YAML from any source: with numbers as ROS reads them, and within limits.

Nesting, values and whole numbers are limited: no text takes long, or gives values that cannot be shown.
"""

import re
from typing import Any

import yaml
from yaml.composer import Composer

from trackslip_common.errors import InputError

MAX_CHARACTERS = 1_000_000  # characters
_MAX_DEPTH = 40  # levels of mappings and lists
_MAX_VALUES = 100_000  # values
_LONGEST_NUMBER = 100  # characters of a whole number
_INTEGER_LIMIT = 2**63  # of a whole number, as in a ROS parameter
# Exceptions of PyYAML's constructors for wrong tags and values, beside its own errors.
_PARSER_ERRORS = (yaml.YAMLError, ValueError, KeyError, IndexError, AttributeError, TypeError, OverflowError)


class _Loader(Composer, yaml.CSafeLoader):
    """Reads ``1e-3`` and ``1.5e6`` as numbers, not text, and rejects texts beyond the limits.

    Nodes are composed here from events of libyaml, which reads ten times faster than PyYAML's own parser.
    """

    def __init__(self, text: str) -> None:
        yaml.CSafeLoader.__init__(self, text)
        Composer.__init__(self)
        self._depth = 0
        self._values = 0  # so far; aliases count as often as they are used
        self._values_of: dict[yaml.Node, int] = {}  # number of values of each complete node

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node:
        """Compose a node; reject it if it is too deep, an alias of a node around it, or too large."""
        event = self.peek_event()
        if self._depth >= _MAX_DEPTH:
            raise _yaml_error(event, f"nested too deep; accepted: up to {_MAX_DEPTH} levels")
        self._depth += 1
        before = self._values
        node: yaml.Node = super().compose_node(parent, index)  # type: ignore[assignment]
        if isinstance(event, yaml.AliasEvent):
            if node not in self._values_of:
                raise _yaml_error(event, "a recursive alias")
            self._values += self._values_of[node]
        else:
            self._values += 1
            _check_keys(node)
            self._values_of[node] = self._values - before
        if self._values > _MAX_VALUES:
            raise _yaml_error(event, f"too many values; accepted: up to {_MAX_VALUES}")
        self._depth -= 1
        return node

    def construct_whole_number(self, node: yaml.ScalarNode) -> int:
        """An integer of 64 bits."""
        value: int = self.construct_yaml_int(node) if len(node.value) <= _LONGEST_NUMBER else _INTEGER_LIMIT
        if not -_INTEGER_LIMIT <= value < _INTEGER_LIMIT:
            raise _yaml_error(node, "a whole number beyond 64 bits")
        return value


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+$"),
    list("-+.0123456789"),
)
_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_whole_number)


def parse_yaml(text: str, where: str) -> Any:
    """Contents of a YAML text; ``where`` begins the message.

    Raises:
        InputError: the text is not YAML, or exceeds the limits.
    """
    if len(text) > MAX_CHARACTERS:
        raise InputError(f"{where}: {len(text)} characters; accepted: up to {MAX_CHARACTERS}")
    try:
        return yaml.load(text, Loader=_Loader)
    except _PARSER_ERRORS as error:
        raise InputError(f"{where}: not YAML ({_reason_of(error, text)})") from error


def _reason_of(error: Exception, text: str) -> str:
    """The reason why a text is not YAML, with its line and column."""
    if not isinstance(error, (yaml.YAMLError, ValueError)):
        return "a value that is not of its tag"
    mark = getattr(error, "problem_mark", None)
    if mark is not None and text[mark.index : mark.index + 1] == "\t":
        return f"a tab in line {mark.line + 1}, column {mark.column + 1}; accepted: blanks"
    reason = " ".join(str(error).split()).replace('in "<unicode string>", ', "in ")
    if "maximum nesting depth" in reason:  # PyYAML's own limit, from 6.0.4 on
        return f"nested too deep; accepted: up to {_MAX_DEPTH} levels"
    return reason


def parse_mapping(text: str, where: str) -> dict[str, Any]:
    """Contents of a YAML text that is a mapping.

    Raises:
        InputError: the text is not YAML, exceeds the limits, or is no mapping.
    """
    tree = parse_yaml(text, where)
    if not isinstance(tree, dict):
        raise InputError(f"{where}: expected names and values (a YAML mapping) at the top level")
    return tree


def _check_keys(node: yaml.Node) -> None:
    """Reject a mapping with a duplicate key, of which PyYAML would silently use one."""
    if isinstance(node, yaml.MappingNode):
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                raise _yaml_error(key, f"'{key.value}' is duplicated")
            seen.add(str(key.value))


def _yaml_error(at: Any, problem: str) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=at.start_mark)
