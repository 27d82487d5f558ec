# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Explains why a replay gives no estimate, or no heading, in terms that a user can act on."""

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from trackslip_bags.importing.bag_readings import READERS
from trackslip_bags.input_filters import InputFilters, relative_name
from trackslip_bags.reader import Bag
from trackslip_common.errors import joined_names
from trackslip_common.orientations import is_heading_known
from trackslip_common.tally import Tally
from trackslip_common.topics import TOPICS
from trackslip_estimation.slip.levers import UNKNOWN_HEADING
from trackslip_estimation.slip.measurements import SET_POSE, Outcome
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.sources import nonempty_names
from trackslip_tools.replay.inputs import SPROCKETS

_WAITING = Outcome.WAITING.name.lower()
_FIXES_OF_OTHER_TYPES = ("fix", "tf")
_INITIAL_POSE = "slip_estimator.start=initial_pose"
_NOT_FIXES = ("reference_pose",)  # poses that are no source by default


@dataclass
class ProcessingCounts:
    """Inputs and results of the estimator, as counts."""

    input_counts: Counter[str]  # by source
    rejected: Tally
    heading_variance: float | None = None  # rad², of the last estimate; None: no estimate


def explain_missing_estimate(
    bag: Bag, p: SlipEstimatorParameters, filters: InputFilters, processed: ProcessingCounts
) -> str:
    """The reason in one clause; empty if there is an estimate with a heading."""
    if processed.heading_variance is not None:
        if processed.heading_variance <= UNKNOWN_HEADING**2:
            return ""
        heading = "heading unknown"
        if is_heading_known(processed.heading_variance):
            heading += f" (±{math.degrees(math.sqrt(processed.heading_variance)):.0f}°)"
        return (
            f"{heading}: it is found from fixes along some metres driven, or from a "
            "source with a heading, or initial_yaw with its initial_yaw_stddev"
        )
    if not processed.input_counts[SPROCKETS]:
        return "no sprockets between --start and --stop"
    if _are_all_rejected(processed, [SPROCKETS]):
        return f"every sample of the sprockets was rejected ({_rejection_reasons(processed, [SPROCKETS])})"
    if p.start != "first_fix":
        return "no sprocket sample could start it"
    sources = nonempty_names(p.pose_sources)
    rejected = processed.rejected.by_source()  # messages of another frame do not reach the estimator
    active = [
        source for source in (*sources, SET_POSE) if processed.input_counts[source] or source in rejected
    ]
    if not active:
        hidden = {edit.topic for edit in filters.withhold} & set(sources)
        why = f"nothing on {', '.join(sources)}" if sources else "pose_sources names none"
        why = f"{', '.join(sorted(hidden))} is withheld" if hidden else why
        return f"no fix came: {why}; {_other_start(bag, filters, sources)}"
    if _are_all_rejected(processed, active):
        return f"every fix was rejected ({_rejection_reasons(processed, active)})"
    return "no sprockets after the first fix"


def count_since_start(reasons: Mapping[str, int]) -> int:
    """Number of rejections without those of measurements that waited for the start, from reason → number."""
    return sum(count for reason, count in reasons.items() if reason != _WAITING)


def _are_all_rejected(processed: ProcessingCounts, sources: Iterable[str]) -> bool:
    """Whether all inputs of these sources were rejected; those that waited for a start count as usable."""
    by_source = processed.rejected.by_source()
    return all(
        count_since_start(by_source.get(source, {})) >= processed.input_counts[source] for source in sources
    )


def _rejection_reasons(processed: ProcessingCounts, sources: Iterable[str]) -> str:
    by_source = processed.rejected.by_source()
    return "; ".join(
        f"{source}: {', '.join(f'{n} {reason}' for reason, n in by_source.get(source, {}).items())}"
        for source in sources
    )


def start_setting(bag: Bag, p: SlipEstimatorParameters) -> str:
    """The setting with which a bag without fixes of its pose sources can start; empty where it has fixes."""
    names = {relative_name(topic) for topic, info in bag.topics.items() if info.count}
    if p.start != "first_fix" or names & {*p.pose_sources, SET_POSE}:
        return ""
    return _pose_source_setting(_other_poses(_types(bag, InputFilters()), p.pose_sources)) or _INITIAL_POSE


def _other_start(bag: Bag, filters: InputFilters, sources: Collection[str]) -> str:
    """Other topics of the bag that could be a pose source, and the option with which a replay starts."""
    types = _types(bag, filters)
    others = _other_poses(types, sources)
    if others:
        return f"the bag has {', '.join(others)} (--set {_pose_source_setting(others)})"
    foreign = [name for name, kind in types.items() if _is_convertible(name, kind)]
    of_import = (
        f"trackslip import makes fixes of {joined_names(foreign)} (docs/import.md); " if foreign else ""
    )
    return f"{of_import}--set {_INITIAL_POSE} follows tracks and gyro from 0, 0 without fixes"


def _types(bag: Bag, filters: InputFilters) -> dict[str, str]:
    """Type of each topic with messages, by its name after the filters' remapping."""
    return {
        filters.remap.get(relative_name(topic), relative_name(topic)): info.type_name
        for topic, info in sorted(bag.topics.items())
        if info.count
    }


def _other_poses(types: Mapping[str, str], sources: Collection[str]) -> list[str]:
    pose = TOPICS["box_pose"].type_name
    return [name for name, kind in types.items() if kind == pose and name not in (*sources, SET_POSE)]


def _pose_source_setting(others: Sequence[str]) -> str:
    """The setting that makes the first of other poses a source; empty without any."""
    first = next((name for name in others if name not in _NOT_FIXES), next(iter(others), ""))
    return f"slip_estimator.pose_sources=[{first}]" if first else ""


def _is_convertible(name: str, type_name: str) -> bool:
    """Whether an import makes fixes of a topic, which the estimator itself does not publish."""
    return ("pose", type_name) in READERS and (name not in TOPICS or name in _FIXES_OF_OTHER_TYPES)
