# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The setup check of a bag."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trackslip._values import as_name, as_text, as_texts, json_text
from trackslip_bags.reader import open_bag
from trackslip_common.compiling import announce_compilation
from trackslip_common.errors import collect_output
from trackslip_common.yaml_tree import section
from trackslip_estimation.setup_check.finding import Result
from trackslip_tools.check.bag import check_bag, setup_report
from trackslip_tools.cli import replay_options


@dataclass(frozen=True, eq=False)
class SetupCheck(Result):
    """Setup mistakes that explain contradictions between sensors; ``str`` of it is the command's output."""

    def __str__(self) -> str:
        return setup_report(self)


def check(
    bag: Path | str,
    *,
    vehicle: str | None = None,
    params: Sequence[str] = (),
    settings: Mapping[str, Any] | None = None,
    namespace: str = "",
) -> SetupCheck:
    """Check the setup of a bag, as ``trackslip check`` does.

    Args:
        bag: rosbag2 directory (MCAP or SQLite), ``.mcap`` or ``.db3`` file.
        vehicle: a name of ``config/vehicles``, or a file; None: the bag's.
        params: ROS parameter files over the bag's own.
        settings: parameters over all files: ``{"slip_estimator.sources.gnss_pose.lever_arm_x": -1.2}``.
        namespace: of the machine, where a bag has several.

    Raises:
        InputError: the bag, a parameter or an option cannot be used.
    """
    with (
        announce_compilation(),
        collect_output(),
        open_bag(as_text("bag", bag), as_text("namespace", namespace)) as opened,
    ):
        files, vehicle = as_texts("params", params), as_name("vehicle", vehicle)
        p = replay_options.parameters_of(opened, files, setting_texts(settings), vehicle)
        return check_of_result(check_bag(opened, p))


def check_of_result(result: Result) -> SetupCheck:
    """A ``SetupCheck`` from the result of the setup check."""
    return SetupCheck(result.causes, result.undetermined, result.facts, result.measured)


def setting_texts(settings: Mapping[str, Any] | None) -> list[str]:
    """Settings as texts for ``--set``, such as ``slip_estimator.max_gap=3.0``.

    Raises:
        InputError: a parameter cannot have such a value.
    """
    tree = section("settings", {} if settings is None else settings)
    return [f"{name}={json_text(f'settings: {name}', value)}" for name, value in tree.items()]
