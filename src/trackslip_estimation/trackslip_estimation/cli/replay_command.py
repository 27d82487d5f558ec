# SPDX-License-Identifier: Apache-2.0
"""``trackslip replay``: the estimator over a bag."""

import argparse
import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trackslip_common.config_files import config_file, node_parameters, parse_yaml, read_yaml
from trackslip_common.errors import ExitCode, InputError
from trackslip_common.parameters import flat_fields
from trackslip_common.topics import TOPICS
from trackslip_estimation.bags.parameters import bag_parameters
from trackslip_estimation.bags.reader import Bag, open_bag, require_topics
from trackslip_estimation.replay.edits import Edits, parse_remap, parse_thin, parse_withhold, relative
from trackslip_estimation.replay.inputs import SPROCKETS
from trackslip_estimation.replay.output import summary, text, write_estimates
from trackslip_estimation.replay.run import replay
from trackslip_estimation.slip_parameters import NODE, SlipEstimatorParameters, load_slip_parameters

DESCRIPTION = "Run the slip estimator over a bag, in process, in the order in which it ran live."
EXAMPLE = "trackslip replay out/demo/bag --withhold box_pose:10:40 --set slip_estimator.pose_timeouts=[3.0]"

_LONGEST = 1e9  # s, some thirty years
_POSES = (TOPICS["box_pose"].type_name, TOPICS["odometry"].type_name)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add = parser.add_argument
    add("bag", metavar="BAG", type=Path, help="rosbag2 directory (MCAP or SQLite), .mcap or .db3 file")
    add("--params", metavar="FILE", nargs="+", default=[], help="ROS parameter files over the bag's own")
    add(
        "--set", metavar="node.param=value", action="append", default=[], help="one parameter, over all files"
    )
    add("--remap", metavar="from:=to", action="append", default=[], help="read topic 'from' as 'to'")
    add("--start", metavar="S", type=float, default=0.0, help="seconds from the bag's first message")
    add("--stop", metavar="S", type=float, default=float("inf"), help="seconds from the bag's first message")
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
    add("--seed", metavar="N", type=_seed, default=0, help="of the added noise")
    add("--reference", metavar="TOPIC", help="score against this topic, every sample of it")
    add("--output", metavar="BAG", type=Path, help="write the estimates to a new bag")
    add("--json", metavar="FILE", type=Path, help="write the summary as JSON")


def run(args: argparse.Namespace) -> int:
    """Replay, print the summary, write what was asked for.

    Raises:
        InputError: the bag, a parameter or an option cannot be used.
    """
    edits = _edits(args)
    with open_bag(args.bag) as bag:
        if bag.damage:
            print(f"note: {bag.damage}", file=sys.stderr)
        p = _parameters(bag, args)
        reference = relative(args.reference) if args.reference else None
        _require_named(bag, p, edits, reference)
        result = replay(bag, p, edits, reference)
    print(text(result))
    if args.output is not None:
        write_estimates(args.output, result, p)
        print(f"estimates: {args.output}")
    if args.json is not None:
        _write_json(args.json, summary(result))
    return ExitCode.DONE if result.estimates else ExitCode.FAILED


def _seed(text: str) -> int:
    """A seed of numpy's generators."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"'{text}' is refused; accepted: a whole number >= 0")
    return int(text)


def _write_json(path: Path, content: dict[str, Any]) -> None:
    try:
        path.write_text(json.dumps(_without_nan(content), indent=2, allow_nan=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"--json: '{path}' cannot be written ({error.strerror})") from error


def _without_nan(value: Any) -> Any:
    """null for what is not a finite number, which JSON does not have."""
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _require_named(bag: Bag, p: SlipEstimatorParameters, edits: Edits, reference: str | None) -> None:
    """A topic that an option names and nobody knows is a slip of the pen."""
    require_topics(bag, edits.remap)
    types = {edits.remap.get(relative(t), relative(t)): info.type_name for t, info in bag.topics.items()}
    if reference is not None and reference not in types:
        require_topics(bag, [reference])
    if reference is not None and types[reference] not in _POSES:
        accepted = " or ".join(_POSES)
        raise InputError(f"--reference {reference}: it is a {types[reference]}; accepted: {accepted}")
    known = types.keys() | {SPROCKETS, *filter(None, (*p.pose_sources, *p.yaw_rate_sources))}
    for option, named in (("--withhold", edits.withhold), ("--thin", edits.thin)):
        for edit in named:
            if edit.topic not in known:
                there = ", ".join(sorted(known))
                raise InputError(f"{option} {edit.topic}: there is no such topic; accepted: {there}")


def _edits(args: argparse.Namespace) -> Edits:
    if not -_LONGEST <= args.start < args.stop or _LONGEST < args.stop < math.inf:
        accepted = f"start before stop, both at most {_LONGEST:g} s"
        raise InputError(f"--start {args.start:g} --stop {args.stop:g}: accepted: {accepted}")
    return Edits(
        start_s=args.start,
        stop_s=args.stop,
        remap=dict(map(parse_remap, args.remap)),
        withhold=tuple(map(parse_withhold, args.withhold)),
        thin=tuple(map(parse_thin, args.thin)),
        seed=args.seed,
    )


def _parameters(bag: Bag, args: argparse.Namespace) -> SlipEstimatorParameters:
    """Defaults, then what the bag carries, then files, then ``--set``: the last one counts."""
    known = {name for name, _, _ in flat_fields(SlipEstimatorParameters)}
    carried = bag_parameters(bag)
    for name in sorted(carried.keys() - known):
        print(f"note: the bag's parameter '{name}' is not one of this version", file=sys.stderr)
    layers: list[Mapping[str, Any]] = [{n: v for n, v in carried.items() if n in known}]
    for name in args.params:
        path = config_file(name)
        layer = node_parameters(read_yaml(path), NODE, str(path))
        if not layer:
            accepted = f"{NODE}: {{ros__parameters: {{...}}}}, or /** for {NODE}"
            raise InputError(f"--params {path}: nothing for {NODE} in it; accepted: {accepted}")
        layers.append(layer)
    layers.append(dict(map(parse_set, args.set)))
    return load_slip_parameters(*layers)


def parse_set(text: str) -> tuple[str, Any]:
    """``slip_estimator.history_window=3.0`` → dotted name within the node, value as YAML reads it.

    Raises:
        InputError: the text has another form.
    """
    name, sign, value = text.partition("=")
    node, dot, parameter = name.partition(".")
    if not sign or not dot or not parameter or node != NODE:
        raise InputError(f"--set {text}: accepted: {NODE}.<parameter>=<value>")
    return parameter, parse_yaml(value, f"--set {text}")
