# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Options of all commands that replay bags: part of the bag, hidden topics, parameters."""

import argparse
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from trackslip_bags.input_filters import InputFilters, parse_remap, parse_thin, parse_withhold, relative_name
from trackslip_bags.namespace import machine_namespaces
from trackslip_bags.parameters import bag_vehicle, stated_parameters
from trackslip_bags.reader import Bag, require_topics
from trackslip_common.config_files import config_file, node_defaults, node_parameters, read_yaml
from trackslip_common.errors import InputError, collect_output, did_you_mean, show, suggestion
from trackslip_common.parameters import Parameters, flat_fields, known_names
from trackslip_common.topics import TOPICS
from trackslip_common.vehicle_files import DEFAULT_VEHICLE_NOTE, has_vehicle_name, load_vehicle, vehicle_layer
from trackslip_common.vehicle_files import TOPIC as VEHICLE
from trackslip_common.yaml_text import parse_yaml
from trackslip_estimation.setup_check.finding import Result
from trackslip_estimation.slip.parameters import (
    GNSS_POSE,
    NODE,
    SlipEstimatorParameters,
    load_slip_parameters,
)
from trackslip_estimation.soil.records import HYDRAULICS
from trackslip_estimation.soil.soil_parameters import NODE as SOIL_NODE
from trackslip_estimation.soil.soil_parameters import SoilEstimatorParameters, load_soil_parameters
from trackslip_tools.check.bag import check_bag, setup_summary
from trackslip_tools.cli import shared_options
from trackslip_tools.replay.inputs import SPROCKETS

_PARAMETER_CLASSES: Mapping[str, type[Parameters]] = {
    NODE: SlipEstimatorParameters,
    SOIL_NODE: SoilEstimatorParameters,
}
_MAX_TIME_S = 1e9  # s, about thirty years
_POSE_TYPES = (TOPICS["box_pose"].type_name, TOPICS["odometry"].type_name)


@dataclass(frozen=True)
class ReplayOptions:
    """Part of a bag to replay, hidden inputs, the topic to score against, and parameters over the bag's."""

    start: float = 0.0  # s from the bag's first message
    stop: float = math.inf  # s from the bag's first message
    withhold: Sequence[str] = ()  # TOPIC[:T0:T1], s
    thin: Sequence[str] = ()  # TOPIC:HZ[:SIGMA], m
    seed: int = 0
    remap: Sequence[str] = ()  # from:=to
    reference: str | None = None  # topic
    vehicle: str | None = None  # a name of ``config/vehicles``, or a file
    params: Sequence[str] = ()  # parameter files
    set: Sequence[str] = ()  # node.parameter=value

    def filters(self, bag: Bag | None = None) -> InputFilters:
        """The input filters of these options.

        Raises:
            InputError: an option has another form, or a value out of range, or the bag ends before ``start``.
        """
        if not -_MAX_TIME_S <= self.start < self.stop or _MAX_TIME_S < self.stop < math.inf:
            accepted = f"start before stop, both at most {_MAX_TIME_S:g} s"
            raise InputError(f"--start {self.start:g} --stop {self.stop:g}: accepted: {accepted}")
        if bag is not None and self.start > bag.duration_s:
            ends = f"bag '{bag.path}' ends after {bag.duration_s:.1f} s"
            raise InputError(f"--start {self.start:g}: {ends}; accepted: at most that")
        return InputFilters(
            start_s=self.start,
            stop_s=self.stop,
            remap=dict(map(parse_remap, self.remap)),
            withhold=tuple(map(parse_withhold, self.withhold)),
            thin=tuple(map(parse_thin, self.thin)),
            seed=self.seed,
        )


def options_of(args: argparse.Namespace) -> ReplayOptions:
    """The options of a command line, as declared by ``add_options``."""
    return ReplayOptions(**{field.name: getattr(args, field.name) for field in fields(ReplayOptions)})


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare these options, ``--set``, ``--vehicle`` and ``--namespace``."""
    add, usual = parser.add_argument, ReplayOptions()
    shared_options.add_set(parser)
    shared_options.add_vehicle(parser, "the bag's")
    shared_options.add_namespace(parser)
    add("--remap", metavar="from:=to", action="append", default=[], help="read topic 'from' as 'to'")
    add("--start", metavar="S", type=float, default=usual.start, help="seconds from the bag's first message")
    add("--stop", metavar="S", type=float, default=usual.stop, help="seconds from the bag's first message")
    add(
        "--withhold",
        metavar="TOPIC[:T0:T1]",
        action="append",
        default=[],
        help="hide a topic from the estimator",
    )
    add(
        "--thin",
        metavar="TOPIC:HZ[:SIGMA]",
        action="append",
        default=[],
        help="keep a topic at HZ; SIGMA m of noise is added to its positions",
    )
    add("--seed", metavar="N", type=_parse_seed, default=usual.seed, help="of the added noise")
    add("--reference", metavar="TOPIC", help="score against this topic, every sample of it")


def add_force(parser: argparse.ArgumentParser) -> None:
    """Declare ``--force``."""
    parser.add_argument(
        "--force",
        action="store_true",
        help="exit code 0 although the setup check found a mistake (trackslip check)",
    )


def parameters_of(
    bag: Bag, files: Iterable[str] = (), settings: Iterable[str] = (), vehicle: str | None = None
) -> SlipEstimatorParameters:
    """Defaults, overridden in turn by the bag's parameters, the named vehicle, files, and ``--set``.

    Prints the vehicle's name.

    Raises:
        InputError: a file, a name or a value is rejected.
    """
    of_bag = bag_vehicle(bag)
    bag_layer, *layers = _parameter_layers(bag, files, settings, NODE)
    named: dict[str, Any] = {} if vehicle is None else {VEHICLE: vehicle, **_antenna_of(vehicle, bag_layer)}
    p = load_slip_parameters(vehicle_layer(of_bag) if of_bag is not None else {}, bag_layer, named, *layers)
    if any(map(has_vehicle_name, (named, *layers))):
        show(f"vehicle: {p.vehicle.name}")
    elif of_bag is not None:
        show(f"vehicle: {p.vehicle.name}, the bag's")
    else:
        others = ", ".join(filter(None, machine_namespaces(bag.topics)))
        show(
            DEFAULT_VEHICLE_NOTE + (f"; it has machines in --namespace {others}" if others else ""),
            is_note=True,
        )
    return p


def _antenna_of(vehicle: str, bag_layer: Mapping[str, Any]) -> dict[str, Any]:
    """The antenna's lever arm of the named vehicle, if the bag has one; prints both if they differ."""
    sensors = load_vehicle(vehicle).sensors
    names = {f"sources.{GNSS_POSE}.lever_arm_{axis}": axis for axis in "xyz"}
    if sensors is None or sensors.antenna is None or not bag_layer.keys() >= names.keys():
        return {}
    antenna = {name: getattr(sensors.antenna, axis) for name, axis in names.items()}
    if any(bag_layer[name] != value for name, value in antenna.items()):
        before, now = (", ".join(f"{values[name]:g}" for name in names) for values in (bag_layer, antenna))
        show(f"antenna: {now} m, as --vehicle has it; the bag was recorded with {before} m")
    return antenna


def soil_parameters_of(
    bag: Bag, p: SlipEstimatorParameters, files: Iterable[str] = (), settings: Iterable[str] = ()
) -> SoilEstimatorParameters | None:
    """As ``parameters_of``, for the soil estimator with the vehicle of ``p``; None without hydraulics.

    Prints missing vehicle data, if these prevent an estimate of the soil.

    Raises:
        InputError: a file, a name or a value is rejected.
    """
    if not any(relative_name(topic) == HYDRAULICS for topic in bag.topics):
        return None
    if p.vehicle.missing_groups_message:
        show(f"soil: {p.vehicle.missing_groups_message}: no forces and no soil are estimated")
        return None
    bag_layer, *layers = _parameter_layers(bag, files, settings, SOIL_NODE)
    return load_soil_parameters(bag_layer, *layers, vehicle_layer(p.vehicle))


def _parameter_layers(
    bag: Bag, files: Iterable[str], settings: Iterable[str], node: str
) -> list[Mapping[str, Any]]:
    """Parameters of a node from the bag, from each file, and from ``--set``, in this order."""
    bag_layer = _bag_parameters(bag, node)
    file_layers = [_file_parameters(name, node, bag_layer) for name in files]
    return [bag_layer, *file_layers, parse_settings(settings, node)]


def _bag_parameters(bag: Bag, node: str) -> Mapping[str, Any]:
    """The bag's parameters that this version has."""
    recorded, where = stated_parameters(bag, node), f"bag '{bag.path}'"
    known = _known_parameters(node, recorded, where)
    for name in sorted(recorded.keys() - known):
        show(f"note: parameters of {where}: '{name}' is not one of this version", file=sys.stderr)
    return {name: value for name, value in recorded.items() if name in known}


def _file_parameters(name: str, node: str, bag_layer: Mapping[str, Any]) -> Mapping[str, Any]:
    """The parameters of a node in a file, without those for other nodes in its shared sections."""
    path = config_file(name)
    tree = read_yaml(path)
    by_node = {n: node_parameters(tree, n, str(path)) for n in _PARAMETER_CLASSES}
    if not any(by_node.values()):
        accepted = f"{NODE}: {{ros__parameters: {{...}}}}, or /** for {NODE}"
        raise InputError(f"--params {path}: nothing for {NODE} in it; accepted: {accepted}")
    values = by_node[node]
    known = _known_parameters(node, {**bag_layer, **values}, str(path))
    others = node_parameters(tree, "", str(path)).keys() - known
    for other in sorted(others) if node == NODE else ():
        if other not in {n for n, _, _ in flat_fields(_PARAMETER_CLASSES[SOIL_NODE])}:
            note = f"'{other}', given to many nodes, is none of {NODE}{did_you_mean(other, known)}"
            show(f"note: {path}: {note}", file=sys.stderr)
    return {n: v for n, v in values.items() if n not in others}


def _known_parameters(node: str, values: Mapping[str, Any], where: str) -> set[str]:
    """Names of a node's parameters, when these values override its defaults."""
    kind = _PARAMETER_CLASSES[node]
    return {
        *known_names(kind, kind.overlay(node_defaults(node, f"{node}.yaml"), values), where),
        *kind.EXTRA_NAMES,
    }


def read_settings(
    bag: Bag, options: ReplayOptions
) -> tuple[SlipEstimatorParameters, InputFilters, str | None]:
    """Parameters, input filters, and the topic to score against.

    Raises:
        InputError: a file, a name or a value is rejected, or an option names an unknown topic.
    """
    filters, reference = options.filters(bag), relative_name(options.reference or "") or None
    p = parameters_of(bag, options.params, options.set, options.vehicle)
    _require_named_topics(bag, p, filters, reference)
    return p, filters, reference


def check_setup(bag: Bag, vehicle: str | None = None) -> Result | None:
    """Print and return the result of the setup check of a whole bag; None without sprockets."""
    if not any(relative_name(topic) == SPROCKETS for topic in bag.topics):
        return None
    with collect_output():  # suppresses the line on the vehicle, printed with the rest
        p = parameters_of(bag, vehicle=vehicle)
    result = check_bag(bag, p)
    show(setup_summary(result))
    return result


def note_damage(bag: Bag) -> None:
    """Print the damage of a bag."""
    if bag.damage:
        show(f"note: {bag.damage}", file=sys.stderr)


def _require_named_topics(
    bag: Bag, p: SlipEstimatorParameters, filters: InputFilters, reference: str | None
) -> None:
    """Raise InputError if an option names an unknown topic."""
    require_topics(bag, filters.remap)
    types = {
        filters.remap.get(relative_name(t), relative_name(t)): info.type_name
        for t, info in bag.topics.items()
    }
    if reference is not None and reference not in types:
        require_topics(bag, [reference])
        renamed = f"--remap reads it as {filters.remap[reference]}"
        raise InputError(f"--reference {reference}: {renamed}; accepted: the name that it has then")
    if reference is not None and types[reference] not in _POSE_TYPES:
        accepted = " or ".join(_POSE_TYPES)
        raise InputError(f"--reference {reference}: it is a {types[reference]}; accepted: {accepted}")
    known = types.keys() | {SPROCKETS, *p.timeouts_ns()}
    for option, named in (("--withhold", filters.withhold), ("--thin", filters.thin)):
        for edit in named:
            if edit.topic not in known:
                hint = suggestion(edit.topic, sorted(known))
                raise InputError(f"{option} {edit.topic}: there is no such topic{hint}")


def parse_settings(texts: Iterable[str], node: str) -> dict[str, Any]:
    """Dotted name → value, from the texts of ``--set`` for one of the two estimators.

    Raises:
        InputError: a text is not for the other estimator and has another form.
    """
    other = {NODE: SOIL_NODE, SOIL_NODE: NODE}[node]
    return dict(parse_set(text, node) for text in texts if not text.startswith(f"{other}."))


def parse_set(text: str, of_node: str = NODE) -> tuple[str, Any]:
    """``slip_estimator.history_window=3.0`` → dotted name within the node, value as parsed by YAML.

    Raises:
        InputError: the text has another form.
    """
    name, sign, value = text.partition("=")
    node, dot, parameter = name.partition(".")
    if not sign or not dot or not parameter or node != of_node:
        raise InputError(f"--set {text}: accepted: {of_node}.<parameter>=<value>")
    return parameter, parse_yaml(value, f"--set {text}")


def _parse_seed(text: str) -> int:
    """Parse a seed of numpy's generators."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"'{text}' is refused; accepted: a whole number >= 0")
    return int(text)
