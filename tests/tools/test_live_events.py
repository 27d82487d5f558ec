# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Lights of the live page: levels, ages, rates, silent nodes, untrusted names; events: each change once."""

import math
from collections.abc import Sequence

import pytest
from fixtures.live_messages import diagnostics

from trackslip_estimation.soil.classes import NONE
from trackslip_tools.report.events import MAX_EVENTS, Events
from trackslip_tools.report.lights import MAX_LIGHTS, SILENT_S, Level, Light, Lights, statuses_of


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
    for k in range(1500):
        events.add_value_changes({f"a{k} gated": "1", f"b{k}": "not observed yet"}, float(k), 0.0)
        events.add(Level.WARN, f"news {'x' * k}", float(k), 0.0)
    assert len(events.recent) == MAX_EVENTS
    assert events.count == 1500
    assert max(len(text) for text in reported(events)) < 250
    assert (
        sum(len(part) for part in vars(events).values() if hasattr(part, "__len__")) < 3 * MAX_EVENTS + 2000
    )


# Lights


def lit(lights: Lights, now_s: float) -> dict[str, tuple[Level, str]]:
    return {light.name: (light.level, light.message) for light in lights.lights_at(now_s)}


def receive(
    lights: Lights, now_s: float, name: str, level: int = 0, message: str = "running", **values: str
) -> None:
    lights.update(statuses_of(diagnostics(name, level, message, **values)), now_s)


def test_a_light_shows_the_last_report_of_its_node() -> None:
    lights = Lights()
    receive(lights, 0.0, "sick_pls", 0)
    receive(lights, 1.0, "sick_pls", 2, "not connected: no such file")
    receive(lights, 1.0, "watson_imu", 3, "connected, but no data")
    assert lit(lights, 1.1) == {
        "sick_pls": (Level.ERROR, "not connected: no such file"),
        "watson_imu": (Level.STALE, "connected, but no data"),
    }


def test_a_node_without_reports_for_longer_than_a_period_is_silent() -> None:
    lights = Lights()
    receive(lights, 10.0, "can_driver")
    assert lit(lights, 10.0 + SILENT_S)["can_driver"][0] is Level.OK
    level, message = lit(lights, 10.1 + SILENT_S)["can_driver"]
    assert level is Level.SILENT
    assert "stopped" in message
    receive(lights, 20.0, "can_driver")
    assert lit(lights, 20.5)["can_driver"][0] is Level.OK


def test_age_is_that_of_the_reading_and_grows_between_reports() -> None:
    lights = Lights()
    lights.update(statuses_of(diagnostics("can_driver")), 0.0)
    values = {"rate (Hz)": "99.8", "age (s)": "0.30"}
    lights.update(statuses_of(diagnostics("can_driver", 0, "running", **values)), 5.0)
    (light,) = lights.lights_at(5.5)
    assert light.rate == 99.8
    assert light.age == pytest.approx(0.8)


@pytest.mark.parametrize("text", ["nan", "inf", "", "fast", "1e999"])
def test_malformed_rate_is_ignored(text: str) -> None:
    lights = Lights()
    lights.update(statuses_of(diagnostics("odd", 0, "running", **{"rate (Hz)": text})), 0.0)
    assert math.isnan(lights.lights_at(0.0)[0].rate)


def test_part_no_longer_reported_disappears() -> None:
    lights = Lights()
    message = diagnostics("record")
    message.status += diagnostics("record: inputs", 2, "several publishers of scan").status
    lights.update(statuses_of(message), 0.0)
    assert lit(lights, 0.0).keys() == {"record", "record: inputs"}
    receive(lights, 1.0, "record")
    assert lit(lights, 1.0).keys() == {"record"}


def test_only_the_nodes_of_the_own_namespace_are_shown() -> None:
    message = diagnostics("digger1/sick_pls")
    message.status += diagnostics("digger2/sick_pls").status + diagnostics("sick_pls").status
    assert [status.name for status in statuses_of(message, "/digger1/")] == ["sick_pls"]
    assert len(statuses_of(message)) == 3


def test_rclpys_levels_are_bytes() -> None:
    message = diagnostics("can_driver")
    message.status[0].level = b"\x02"
    assert statuses_of(message)[0].level is Level.ERROR


def test_many_names_and_long_texts_stay_bounded() -> None:
    lights = Lights()
    for k in range(10 * MAX_LIGHTS):
        receive(lights, 0.0, f"node_{k}\x1b[2J", 99, "x" * 100_000)
    shown = lights.lights_at(0.0)
    assert len(shown) == MAX_LIGHTS
    assert lights.left_out == 9 * MAX_LIGHTS
    assert max(len(light.message) for light in shown) < 200
    assert all(light.name.isprintable() for light in shown)
    assert {light.level for light in shown} == {Level.ERROR}
