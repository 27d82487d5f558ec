# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Lights of the live page: levels, ages, rates, silent nodes, and untrusted names."""

import math

import pytest
from fixtures.live_messages import diagnostics

from trackslip_tools.report.lights import MAX_LIGHTS, SILENT_S, Level, Lights, statuses_of


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
