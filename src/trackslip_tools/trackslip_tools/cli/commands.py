# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The commands of ``trackslip``: a description and the module of each."""

from importlib.util import find_spec
from typing import NamedTuple


class Command(NamedTuple):
    """One command; its module has EXAMPLE, ``add_arguments`` and ``run``.

    ``run`` returns the exit code, or raises ``InputError`` if an argument or the thing it names cannot be
    used.
    """

    module: str
    description: str


_COMMANDS = {
    "calibrate": Command(
        "trackslip_tools.cli.calibrate_command",
        "Find rolling radius, gyro scale and mounting, delays and offsets from bags, with 95 % intervals.",
    ),
    "check": Command(
        "trackslip_tools.cli.check_command",
        "Name the mistake of a setup: swapped tracks, wrong signs, "
        "units, delays, lever arms; and its remedy.",
    ),
    "demo": Command(
        "trackslip_sim.demo.command",
        "Simulate a drive, replay it, and open the report: the shortest way to see results (no ROS).",
    ),
    "import": Command(
        "trackslip_tools.cli.import_command",
        "Turn a log of another machine (CSV files, a bag of ROS 1 or ROS 2) into a bag, by a mapping.",
    ),
    "info": Command(
        "trackslip_tools.cli.info_command", "List a bag's topics, types, counts, rates and duration."
    ),
    "live": Command(
        "trackslip_tools.cli.live_command",
        "Show the machine on a page in a browser while it drives (needs ROS), or a bag of it.",
    ),
    "record": Command(
        "trackslip_tools.cli.record_command",
        "Record all topics of the project, and more if wanted, until Ctrl-C; the node 'record' (needs ROS).",
    ),
    "recover": Command(
        "trackslip_tools.cli.recover_command",
        "Rewrite a damaged bag: what can be read of it, with a new index; the damaged one stays.",
    ),
    "replay": Command(
        "trackslip_tools.cli.replay_command",
        "Run the slip estimator over a bag, in process, in the order in which it ran live.",
    ),
    "report": Command(
        "trackslip_tools.cli.report_command",
        "Replay one bag, or several, and show the results on one page of HTML.",
    ),
    "simulate": Command("trackslip_sim.cli", "Drive a scenario on the truth model, and print where it ends."),
    "smooth": Command(
        "trackslip_tools.cli.smooth_command",
        "Smooth a bag: pose and slips at each moment from what came before and after it.",
    ),
    "study": Command(
        "trackslip_sim.study.cli",
        "Estimate many simulated drives, and compare the errors with the least possible, or with the "
        "errors that the estimator expects (config/study.yaml).",
    ),
    "tune": Command(
        "trackslip_tools.cli.tune_command",
        "Find the parameters of the slip estimator that explain bags best, on all cores or a cluster.",
    ),
    "vehicle": Command(
        "trackslip_tools.cli.vehicle_command",
        "Write the file of a new machine from what is known of it; list the existing ones.",
    ),
}


def installed_commands() -> dict[str, Command]:
    """Name → command; those of the simulator only if it is installed."""
    present = {package for package in ("trackslip_tools", "trackslip_sim") if find_spec(package) is not None}
    return {name: c for name, c in _COMMANDS.items() if c.module.partition(".")[0] in present}
