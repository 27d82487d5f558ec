# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip live``: serves a page that shows the machine, from the running graph or a bag."""

import argparse
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import Bag, open_bag
from trackslip_common.config_files import load_parameters
from trackslip_common.errors import InputError, show
from trackslip_estimation.setup_check.finding import Result
from trackslip_tools.cli import publish, replay_options, shared_options
from trackslip_tools.cli.nodes import run_node
from trackslip_tools.cli.progress import progress_bar, replay_progress
from trackslip_tools.live.parameters import DEFAULT_FILES, NODE, LiveParameters, open_sockets

EXAMPLE = "trackslip live out/demo/bag --rate 5"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments; defaults are in ``live.yaml``."""
    add = parser.add_argument
    add("bag", metavar="BAG", type=Path, nargs="?", help="show this bag instead of the graph that runs")
    add("--host", metavar="H", help="address to listen on (default: this computer alone)")
    add("--port", metavar="P", type=int, help="port to listen on; 0: any that is free")
    add(
        "--origin",
        metavar="HOST[:PORT]",
        action="append",
        help="host that browsers may request, besides the address itself",
    )
    shared_options.add_namespace(parser)
    of_bag = parser.add_argument_group("over a bag")
    of_bag.add_argument("--rate", metavar="R", type=publish.parse_rate, help="times real time (default: 1)")
    shared_options.add_vehicle(of_bag, "the bag's")
    of_bag.add_argument("--start", metavar="S", type=float, help="seconds from the bag's first message")


def run(args: argparse.Namespace) -> int:
    """Serve until Ctrl-C; for the running graph this starts the node ``live``."""
    options = {"host": args.host, "port": args.port, "origins": args.origin and tuple(args.origin)}
    options = {name: value for name, value in options.items() if value is not None}
    if args.bag is not None:
        p = load_parameters(LiveParameters, NODE, DEFAULT_FILES, options)
        p.allowed_hosts(p.port)  # reports errors before the replay, as does a socket that is taken
        for one in open_sockets(p.host, p.port):
            one.close()
        with open_bag(args.bag, args.namespace) as bag:
            filters = replay_options.ReplayOptions(start=args.start or 0.0).filters(bag)
            setup = replay_options.check_setup(bag, args.vehicle) or Result()
            with bag_with_estimates(bag, args.vehicle) as whole:
                return _serve(whole, p, args, filters, setup)
    if any(option is not None for option in (args.rate, args.start, args.vehicle)):
        raise InputError("--rate, --start, --vehicle: accepted only together with a BAG")
    namespace = ("-r", f"__ns:=/{args.namespace.strip('/')}") if args.namespace else ()
    return run_node("trackslip_tools.nodes.live", "live", options, *namespace)


def _serve(
    bag: Bag, p: LiveParameters, args: argparse.Namespace, filters: InputFilters, setup: Result
) -> int:
    from trackslip_bags.parameters import bag_vehicle
    from trackslip_common.vehicle_files import load_vehicle
    from trackslip_tools.live.bag import BagFeed
    from trackslip_tools.live.page import page_files
    from trackslip_tools.live.server import PageServer
    from trackslip_tools.live.state import PERIOD, LiveState

    name, rate = f"bag {bag.path.resolve().name}", args.rate or 1.0
    named = None if args.vehicle is None else load_vehicle(args.vehicle)
    vehicle = named or bag_vehicle(bag) or load_vehicle()
    state = LiveState(f"{name} at {rate:g} × real time", vehicle, keeps_vehicle=named is not None)
    if not setup.is_plausible:
        state.set_setup(setup.headline)
    feed = BagFeed(bag, state, rate, filters)
    server = PageServer(page_files(f"Trackslip: {name}"), state.full_state, p)
    server.start()
    try:
        show(f"{server.address} shows {bag.path}; Ctrl-C ends it")
        sys.stdout.flush()
        while not feed.is_finished:
            server.push(feed.advance(time.monotonic()))
            time.sleep(PERIOD)
        show("end of the bag; the page stays open", file=sys.stderr)
        while True:
            server.push(feed.advance(time.monotonic()))
            time.sleep(PERIOD)
    finally:
        server.stop()


@contextmanager
def bag_with_estimates(bag: Bag, vehicle: str | None = None) -> Iterator[Bag]:
    """Context of the bag; if the bag has no estimates, those of a replay are added."""
    if any(topic.removeprefix("/") == "odometry" for topic in bag.topics):
        yield bag
        return
    from trackslip_tools.replay.output import replay_to_bag

    show("the bag has no estimates: replaying it first", file=sys.stderr)
    p = replay_options.parameters_of(bag, vehicle=vehicle)
    soil_p = replay_options.soil_parameters_of(bag, p)
    with TemporaryDirectory(prefix="trackslip_live_") as folder:
        path = Path(folder) / "estimates"
        with progress_bar(bag.duration_s, "replaying") as advance:
            replay_to_bag(path, bag, p, InputFilters(), None, soil_p, replay_progress(bag, advance))
        with open_bag(path) as estimates:
            yield Bag(bag.path, [*bag.sources, *estimates.sources], bag.damage)
