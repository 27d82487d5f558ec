# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip calibrate``: estimates parameters of the machine and its sensors from drives."""

import argparse
import sys
from pathlib import Path

from trackslip_bags.input_filters import relative_name
from trackslip_bags.parameters import bag_vehicle
from trackslip_bags.reader import Bag, open_bag, require_topics
from trackslip_common.errors import ExitCode, InputError, show
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_tools.calibration.calibrate import calibrate
from trackslip_tools.calibration.output import FILE_PREFIX, summary, text, write_parameters
from trackslip_tools.calibration.recording import RecordingReader
from trackslip_tools.check.bag import check_bag, setup_summary
from trackslip_tools.cli import replay_options, shared_options
from trackslip_tools.cli.outputs import refuse_foreign_file, require_writable, write_json
from trackslip_tools.cli.progress import progress_bar, scale_progress

EXAMPLE = "trackslip calibrate bags/slalom_sand out/demo/bag --output calibration.yaml"

_REFERENCE = "reference_pose"  # in imported logs


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add = parser.add_argument
    shared_options.add_bags(parser, "of the same machine; on the same ground for κ and i₀")
    shared_options.add_params(parser, "the first bag's")
    shared_options.add_vehicle(parser, "the first bag's")
    shared_options.add_namespace(parser)
    add("--gyro", metavar="TOPIC", help="the gyro; default: the first of yaw_rate_sources")
    add("--poses", metavar="TOPIC", help=f"fixes; default: the first of pose_sources, or {_REFERENCE}")
    add(
        "--hard-ground",
        action="store_true",
        help="nothing slips on the straights: they show the rolling radius",
    )
    add("--all", action="store_true", help="write also values whose interval holds the present one")
    add("--output", metavar="YAML", type=Path, help="write the parameters for the nodes, with the evidence")
    shared_options.add_json(parser, "everything that was found")


def run(args: argparse.Namespace) -> int:
    """Calibrate, print the findings, and write the outputs."""
    require_writable(output=args.output, json=args.json)
    if args.output is not None:
        refuse_foreign_file("output", args.output, FILE_PREFIX)
    with open_bag(args.bags[0], args.namespace) as bag:
        p = replay_options.parameters_of(bag, args.params, [], args.vehicle)
        gyro, poses = _source_topics(args, bag, p)
        compass = next(iter(p.compasses().items()), None)
    if args.vehicle is None:
        _refuse_other_vehicles(args, p.vehicle.name)
    recordings, setups = [], []
    with progress_bar(len(args.bags), "reading") as advance:
        for path in args.bags:
            with open_bag(path, args.namespace) as bag:
                replay_options.note_damage(bag)
                require_topics(bag, filter(None, (args.gyro, args.poses)))
                advance_bag = scale_progress(advance, bag.duration_s)
                reader = RecordingReader(bag, gyro, poses, compass)
                setups.append(check_bag(bag, p, None, advance_bag, reader.topics, reader.add))
                recordings.append(reader.recording(p.motion))
            for topic, count in recordings[-1].left_out.items():
                why = "values out of range, or stamps of another clock"
                show(f"note: {path}: {count} messages of {topic} are left out: {why}", file=sys.stderr)
    with progress_bar(None, "calibrating"):
        result = calibrate(
            recordings, p, (gyro, poses), setups, hard_ground=args.hard_ground, everything=args.all
        )
    names = [str(path) for path in args.bags]
    for path, setup in zip(args.bags, setups, strict=True):
        show((f"{path}: " if len(setups) > 1 else "") + setup_summary(setup))
    show(text(result))
    if args.output is not None and result.parameters:
        write_parameters(args.output, result, names)
        show(f"parameters: {args.output}")
    elif args.output is not None:
        show(f"nothing new: {args.output} is not written")
    if args.json is not None:
        write_json(args.json, summary(result, names))
    has_values = any(finding.has_value for finding in result.findings.values())
    return ExitCode.DONE if has_values else ExitCode.FAILED


def _refuse_other_vehicles(args: argparse.Namespace, name: str) -> None:
    """Raise InputError if a bag names another vehicle than the first bag's."""
    for path in args.bags[1:]:
        with open_bag(path, args.namespace) as bag:
            vehicle = bag_vehicle(bag)
        if vehicle is not None and vehicle.name != name:
            accepted = "bags of one machine, or --vehicle, if it is the same"
            others = f"'{args.bags[0]}' of {name}"
            raise InputError(f"bag '{path}' is of vehicle {vehicle.name}, {others}; accepted: {accepted}")


def _source_topics(args: argparse.Namespace, bag: Bag, p: SlipEstimatorParameters) -> tuple[str, str]:
    """Topics of gyro and poses; '' if there is none."""
    topics = {relative_name(topic) for topic, info in bag.topics.items() if info.count}
    gyro = args.gyro or next((source for source in p.yaw_rate_sources if source in topics), "")
    poses = args.poses or next((s for s in (*p.pose_sources, _REFERENCE) if s in topics), "")
    return relative_name(gyro), relative_name(poses)
