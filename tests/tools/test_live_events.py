# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Events of the live page: each change is reported once."""

import math

import pytest

from trackslip_estimation.soil.classes import NONE
from trackslip_tools.report.events import MAX_EVENTS, Events
from trackslip_tools.report.lights import Level, Light


def light(level: Level, message: str, name: str = "slip_estimator") -> Light:
    return Light(name, level, message, math.nan, 0.0)


def reported(events: Events) -> list[str]:
    return [event.text for event in events.recent]


def test_a_lost_fix_is_reported_once_and_so_is_its_return() -> None:
    events = Events()
    events.add_light_changes([light(Level.OK, "running")], 0.0, 0.0)
    for k in range(30):
        text = f"nothing accepted of box_pose for {1.2 + k:.1f} s"
        events.add_light_changes([light(Level.WARN, text)], 1.0 + k, 0.0)
    events.add_light_changes([light(Level.OK, "running")], 40.0, 0.0)
    assert reported(events) == ["fix lost: box_pose", "fix back: box_pose"]
    assert [event.level for event in events.recent] == [Level.WARN, Level.OK]


def test_explanations_are_an_event_again_where_another_one_is_the_most_probable() -> None:
    events = Events()
    for k, text in enumerate(
        (
            "three explanations for 0.5 s: gnss_pose is 1.1 m off (60 %), nothing happened (30 %)",
            "two explanations for 1.5 s: gnss_pose is 1.0 m off (90 %), the machine was moved (10 %)",
            "two explanations for 18.3 s: the machine was moved (55 %), gnss_pose is 1.0 m off (45 %)",
        )
    ):
        events.add_light_changes([light(Level.WARN, text)], float(k), 0.0)
    assert [text[: text.index(" for")] for text in reported(events)] == [
        "slip_estimator: three explanations",
        "slip_estimator: two explanations",
    ]


def test_stuck_and_stalled_machine_are_reported_with_the_text_of_the_estimator() -> None:
    events = Events()
    texts = ("getting stuck: left at the limit of the soil", "stalled: both tracks")
    for k, text in enumerate(texts):
        events.add_light_changes([light(Level.WARN, text, "soil_estimator")], float(k), 0.0)
    assert reported(events) == [f"soil_estimator: {text}" for text in texts]


def test_a_node_that_falls_silent_and_comes_back() -> None:
    events = Events()
    for at_s, level, text in (
        (0.0, Level.OK, "running"),
        (2.0, Level.SILENT, "silent"),
        (9.0, Level.OK, "running"),
    ):
        events.add_light_changes([light(level, text, "sick_pls")], at_s, 0.0)
    assert reported(events) == ["sick_pls: silent", "sick_pls: running"]


def test_part_no_longer_reported_has_recovered() -> None:
    events = Events()
    events.add_light_changes([light(Level.ERROR, "several publishers of scan", "record: inputs")], 0.0, 0.0)
    events.add_light_changes([], 1.0, 0.0)
    assert reported(events)[-1] == "record: inputs: recovered"


def test_alternating_state_does_not_fill_the_event_list() -> None:
    events = Events()
    for k in range(60):
        level, text = (Level.OK, "running") if k % 2 else (Level.WARN, f"{k} rejected in the last second")
        events.add_light_changes([light(level, text)], float(k), 0.0)
    assert len(events.recent) == 2


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
