# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Events of the live page: each change is reported once."""

import math
from collections.abc import Sequence

import pytest

from trackslip_estimation.soil.classes import NONE
from trackslip_tools.report.events import MAX_EVENTS, Events
from trackslip_tools.report.lights import Level, Light


def light(level: Level, message: str, name: str) -> Light:
    return Light(name, level, message, math.nan, 0.0)


def reported(events: Events) -> list[str]:
    return [event.text for event in events.recent]


OK, WARN, ERROR, SILENT = Level.OK, Level.WARN, Level.ERROR, Level.SILENT
Status = tuple[Level, str, str]  # level, message, name
LOST = [f"nothing accepted of box_pose for {1.2 + k:.1f} s" for k in range(30)]
COMPETING = (
    "three explanations for 0.5 s: gnss_pose is 1.1 m off (60 %), nothing happened (30 %)",
    "two explanations for 1.5 s: gnss_pose is 1.0 m off (90 %), the machine was moved (10 %)",
    "two explanations for 18.3 s: the machine was moved (55 %), gnss_pose is 1.0 m off (45 %)",
)
STUCK = ("getting stuck: left at the limit of the soil", "stalled: both tracks")
SEVERAL = "several publishers of scan"
CHANGES: dict[str, tuple[Sequence[Status | None], list[str]]] = {
    "a lost fix and its return": (
        [(OK, "running", "slip"), *((WARN, text, "slip") for text in LOST), (OK, "running", "slip")],
        ["fix lost: box_pose", "fix back: box_pose"],
    ),
    "another explanation that is the most probable one": (
        [(WARN, text, "slip") for text in COMPETING],
        [f"slip: {COMPETING[0]}", f"slip: {COMPETING[2]}"],
    ),
    "the text of the estimator": ([(WARN, text, "soil") for text in STUCK], [f"soil: {t}" for t in STUCK]),
    "a silent node and its return": (
        [(OK, "running", "pls"), (SILENT, "silent", "pls"), (OK, "running", "pls")],
        ["pls: silent", "pls: running"],
    ),
    "a part that is no longer reported": (
        [(ERROR, SEVERAL, "record: inputs"), None],
        [f"record: inputs: {SEVERAL}", "record: inputs: recovered"],
    ),
    "a state that alternates": (
        [(OK, "running", "slip") if k % 2 else (WARN, f"{k} rejected", "slip") for k in range(9)],
        ["slip: 0 rejected", "slip: running"],
    ),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_of_a_light_is_reported_once(name: str) -> None:
    statuses, expected = CHANGES[name]
    events = Events()
    for k, status in enumerate(statuses):
        events.add_light_changes([light(*status)] if status else [], float(k), 0.0)
    assert reported(events) == expected


@pytest.mark.parametrize("key", ["box_pose: gated", "box_pose gated"])
def test_rejection_by_the_gate_is_reported_when_it_begins(key: str) -> None:
    events = Events()
    counts = [0, 0, 3, 5, 9, *[9] * 10, 10]
    for k, count in enumerate(counts):
        events.add_value_changes({key: str(count), "sprockets waiting": "7"}, float(k), 0.0)
    assert reported(events) == ["gate rejects box_pose", "gate rejects box_pose"]


def test_learned_state_is_reported_once_when_observed() -> None:
    events = Events()
    for text in (
        "not observed yet",
        "not observed yet",
        "gyro reads 1.9 % low ± 0.5",
        "gyro reads 2.0 % low ± 0.4",
    ):
        events.add_value_changes({"gyro scale": text}, 0.0, 0.0)
    assert reported(events) == ["learned: gyro reads 1.9 % low ± 0.5"]


def test_a_soil_is_named_when_it_is_likely_and_when_another_is() -> None:
    events = Events()
    for sand in (0.4, 0.7, 0.8, 0.5, 0.1):
        events.add_soil_change({"sand": sand, "clay": 0.9 - sand}, 0.0, 0.0, is_identifiable=True)
    assert reported(events) == ["soil found: sand, 70 %", "soil changed to clay, 80 %"]
    unnamed: list[dict[str, float]] = [{}, {NONE: 0.9, "sand": 0.1}]
    for classes in unnamed:
        events.add_soil_change(classes, 0.0, 0.0, is_identifiable=True)
    assert len(events.recent) == 2


def test_memory_is_bounded_whatever_the_values_are_called() -> None:
    events = Events()
    for k in range(5000):
        events.add_value_changes({f"a{k} gated": "1", f"b{k}": "not observed yet"}, float(k), 0.0)
        events.add(Level.WARN, f"news {'x' * k}", float(k), 0.0)
    assert len(events.recent) == MAX_EVENTS
    assert events.count == 5000
    assert max(len(text) for text in reported(events)) < 250
    assert (
        sum(len(part) for part in vars(events).values() if hasattr(part, "__len__")) < 3 * MAX_EVENTS + 2000
    )
