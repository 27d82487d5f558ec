# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A replay of a bag, and its results."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trackslip._check import SetupCheck, check_of_result, setting_texts
from trackslip._estimates import Estimates, estimates_of_rows
from trackslip._values import as_count, as_name, as_number, as_text, as_texts
from trackslip_bags.reader import Bag, open_bag
from trackslip_common.compiling import announce_compilation
from trackslip_common.errors import collect_output
from trackslip_estimation.gnss.localizer import Datum
from trackslip_estimation.slip.records import ESTIMATE
from trackslip_tools.cli import replay_options
from trackslip_tools.cli.replay_options import ReplayOptions
from trackslip_tools.replay import run
from trackslip_tools.replay.growing import GrowingRows
from trackslip_tools.replay.output import summary, text
from trackslip_tools.replay.series import sort_by_stamp


@dataclass(frozen=True, eq=False)
class Result:
    """Result of a replay; ``str`` of it is the command's output."""

    estimates: Estimates
    summary: Mapping[str, Any]  #: contents of ``trackslip replay --json``
    setup: SetupCheck
    notes: tuple[str, ...]  #: further output of the command: vehicle, damage, old names
    text: str

    def __str__(self) -> str:
        return self.text


def replay(
    bag: Path | str,
    *,
    vehicle: str | None = None,
    params: Sequence[str] = (),
    settings: Mapping[str, Any] | None = None,
    start: float = ReplayOptions.start,
    stop: float = ReplayOptions.stop,
    withhold: Sequence[str] = ReplayOptions.withhold,
    thin: Sequence[str] = ReplayOptions.thin,
    seed: int = ReplayOptions.seed,
    remap: Sequence[str] = ReplayOptions.remap,
    reference: str | None = ReplayOptions.reference,
    namespace: str = "",
) -> Result:
    """Run the estimators over a bag in the order in which they ran live, as ``trackslip replay`` does.

    Args:
        bag: rosbag2 directory (MCAP or SQLite), ``.mcap`` or ``.db3`` file.
        vehicle: a name of ``config/vehicles``, or a file; None: the bag's.
        params: ROS parameter files over the bag's own.
        settings: parameters over all files: ``{"slip_estimator.sources.gnss_pose.timeout": 3.0}``.
        start: s from the bag's first message.
        stop: s from the bag's first message.
        withhold: topics that the estimator does not get, ``TOPIC`` or ``TOPIC:T0:T1`` (s); one, or several.
        thin: topics that it gets at a lower rate, ``TOPIC:HZ`` or ``TOPIC:HZ:SIGMA`` (m).
        seed: of the noise that ``thin`` adds.
        remap: ``from:=to``.
        reference: topic to score against; None: ``reference_pose``, or the truth.
        namespace: of the machine, where a bag has several.

    Raises:
        InputError: the bag, a parameter or an option cannot be used.
    """
    options = ReplayOptions(
        as_number("start", start),
        as_number("stop", stop),
        as_texts("withhold", withhold),
        as_texts("thin", thin),
        as_count("seed", seed),
        as_texts("remap", remap),
        as_name("reference", reference),
        as_name("vehicle", vehicle),
        as_texts("params", params),
        setting_texts(settings),
    )
    with (
        announce_compilation(),
        collect_output() as notes,
        open_bag(as_text("bag", bag), as_text("namespace", namespace)) as opened,
    ):
        return replay_open_bag(opened, options, notes)


def replay_open_bag(bag: Bag, options: ReplayOptions, notes: list[str], datum: Datum | None = None) -> Result:
    """Replay an open bag; ``notes``: list of ``collect_output``."""
    p, filters, reference = replay_options.read_settings(bag, options)
    soil_p = replay_options.soil_parameters_of(bag, p, options.params, options.set)
    rows = GrowingRows(ESTIMATE)
    result = run.replay(bag, p, filters, reference, soil_p, lambda part: rows.add(part.estimates))
    all_notes = (*([bag.damage] if bag.damage else []), *notes)
    return Result(
        estimates_of_rows(sort_by_stamp(rows.rows()), datum),
        summary(result, result.elapsed_s),
        check_of_result(result.setup),
        all_notes,
        text(result, result.elapsed_s),
    )
