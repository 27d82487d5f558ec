# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip live``: its refusals, and a bag on the page from the first message to Ctrl-C."""

import asyncio
import json
import signal
import socket
import subprocess
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fixtures.commands import TRACKSLIP
from fixtures.patience import PATIENCE
from tornado.websocket import websocket_connect

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import open_bag
from trackslip_common.errors import ExitCode
from trackslip_common.vehicle_files import load_vehicle
from trackslip_tools.cli import main as cli
from trackslip_tools.cli.live_command import bag_with_estimates
from trackslip_tools.live.bag import BagFeed
from trackslip_tools.live.state import PERIOD, LiveState

BAG = Path(__file__).parents[2] / "bags" / "spot_turn_sand"


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ([str(BAG), "--origin", "http://digger.local"], "http://digger.local"),
        ([str(BAG), "--port", "70000"], "70000"),
        pytest.param(
            [str(BAG), "--host", "no.such.host.invalid"], "no.such.host.invalid", marks=pytest.mark.slow
        ),
        ([str(BAG), "--rate", "0"], "'0'"),
        ([str(BAG), "--start", "1000"], "ends after"),
        ([str(BAG), "--start", "nan"], "start before stop"),
        (["--rate", "2"], "BAG"),
        (["--vehicle", "pc05"], "--vehicle"),
        ([str(BAG), "--vehicle", "nobody"], "nobody"),
        (["no_such_bag"], "no_such_bag"),
    ],
    ids=lambda value: " ".join(value)[-40:] if isinstance(value, list) else "",
)
def test_arguments_that_cannot_be_served_are_refused_in_one_line(
    arguments: list[str], word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["live", *arguments]) == ExitCode.BAD_INPUT
    *_, line = capsys.readouterr().err.splitlines()
    assert word in line
    assert "accepted" in line or "refused" in line


def test_address_is_refused_before_the_bag_is_replayed(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["live", str(BAG), "--host", "0.0.0.0"]) == ExitCode.BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert "origin" in line


def test_taken_port_is_refused_before_the_bag_is_replayed(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        assert cli.main(["live", str(BAG), "--host", "127.0.0.1", "--port", str(port)]) == ExitCode.BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert f"port {port}" in line


@pytest.mark.slow
def test_bag_with_sensors_only_is_shown_with_replayed_estimates() -> None:
    with open_bag(BAG) as bag, bag_with_estimates(bag) as whole:
        state = LiveState("a test", load_vehicle())
        feed = BagFeed(whole, state, 1.0, InputFilters(start_s=8.0))
        wall_s, frames = 100.0, []
        while not feed.is_finished:
            frames.append(feed.advance(wall_s))
            wall_s += 0.5
    shown = json.loads(json.dumps(state.full_state(), allow_nan=False))
    assert len(frames) == pytest.approx((bag.duration_s - 8.0) / 0.5, abs=3)
    assert len(shown["trail"]) >= 1
    assert shown["fixes"]
    motions = {frame["facts"]["motion"] for frame in frames}
    assert "turning" in motions
    assert any(value is not None for row in shown["rows"] for value, _, _ in row)
    last = frames[-1]
    for _ in range(20):
        frame = feed.advance(wall_s)
        wall_s += PERIOD
    assert frame["ended"] == "end of the bag"
    assert frame["number"] == last["number"] + 20
    assert (frame["time"], frame["lights"]) == (last["time"], last["lights"])
    assert all(frame["facts"][name] == text for name, text in last["facts"].items() if text != "–")
    later = state.full_state()
    assert later["ended"] == frame["ended"]
    for name in ("times", "rows", "trail", "fixes", "events"):
        assert json.dumps(later[name]) == json.dumps(shown[name])


@pytest.mark.slow
def test_page_over_a_bag_uses_the_vehicle_option(capsys: pytest.CaptureFixture[str]) -> None:
    with open_bag(BAG) as bag, bag_with_estimates(bag, "excavator_20t") as whole:
        state = LiveState("a test", load_vehicle("excavator_20t"), keeps_vehicle=True)
        feed = BagFeed(whole, state, 1000.0, InputFilters())
        frame: dict[str, Any] = {}
        for wall_s in range(100, 103):
            frame = feed.advance(float(wall_s))
    assert frame["facts"]["vehicle"] == "excavator_20t"
    assert "vehicle: excavator_20t" in capsys.readouterr().out


@pytest.mark.slow
def test_a_lost_fix_is_an_event_over_a_bag_without_diagnostics() -> None:
    """The laser of this drive is unplugged for 8 s."""
    with open_bag(BAG.with_name("outage_sandy_loam")) as bag, bag_with_estimates(bag) as whole:
        state = LiveState("a test", load_vehicle())
        feed = BagFeed(whole, state, 1.0, InputFilters())
        wall_s, reported = 100.0, []
        while not feed.is_finished:
            reported += [(wall_s - 100.0, text) for *_, text in feed.advance(wall_s)["events"]]
            wall_s += 0.25
    fixes = [(at_s, text) for at_s, text in reported if text.startswith("fix")]
    assert [text for _, text in fixes] == ["fix lost: box_pose", "fix back: box_pose"]
    assert fixes[1][0] - fixes[0][0] == pytest.approx(8.0, abs=1.0)


@pytest.fixture
def serving() -> Iterator[tuple[Any, str]]:
    """The running command over a bag, and the address that it prints."""
    command = [*TRACKSLIP, "live", str(BAG), "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        lines = iter(program.stdout.readline, "")
        yield program, next(line.split()[0] for line in lines if line.startswith("http"))
        program.kill()


def test_the_command_serves_until_it_is_interrupted(serving: tuple[Any, str]) -> None:
    program, address = serving
    with urllib.request.urlopen(address, timeout=PATIENCE) as answer:
        assert "live.js" in answer.read().decode()
    port = int(address.rsplit(":", 1)[1].strip("/"))

    async def first() -> Any:
        page = await websocket_connect(f"ws://127.0.0.1:{port}/stream")
        return json.loads(await page.read_message() or "")

    assert "spot_turn_sand" in asyncio.run(asyncio.wait_for(first(), PATIENCE))["source"]
    program.send_signal(signal.SIGINT)
    assert program.wait(PATIENCE) == ExitCode.INTERRUPTED
    assert "Traceback" not in program.stderr.read()
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", port)) != 0
