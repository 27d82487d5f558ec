# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes of a driving graph are killed or stopped, and restarted as a launch file would."""

import os
import random
import signal
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from fixtures.drives_in_sight import to_and_fro
from fixtures.patience import PATIENCE

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.metadata import METADATA
from trackslip_bags.reader import open_bag
from trackslip_bags.recovery.recover import recover
from trackslip_common.errors import InputError
from trackslip_common.make import stamp_ns_of
from trackslip_common.nodes.messages import topic_class
from trackslip_common.nodes.qos import subscriber_qos
from trackslip_estimation.slip.conversions import pose_fix
from trackslip_tools.cli.replay_options import parameters_of
from trackslip_tools.replay.run import replay

pytestmark = pytest.mark.xdist_group("graph")

KILLS = 100
HELD_S = 5.0
WORST_SIGMAS = 4.0
DRIVE_S = 3600.0  # longest supported
TRUTH_WITHIN_S = 600.0  # time for the emulator to compute it on a busy host
LATE_S = 0.05  # delay of the truth by which an emulator counts as starved; its bytes then have wrong stamps
SETTLED_S = 5.0
VICTIMS = (
    *("can_driver", "watson_imu", "sick_pls"),
    *("box_localizer", "slip_estimator", "soil_estimator", "record"),
)
OUTPUTS = ("sprockets", "imu/data_raw", "scan", "box_pose", "odometry", "soil")


@dataclass(frozen=True)
class Node:
    """Executable and parameters of a node."""

    executable: str
    parameters: dict[str, Any]


class Graph:
    """The whole graph while driving; the last message of each topic."""

    def __init__(self, programs, observer, can):
        self._programs, self._observer = programs, observer
        devices = programs.folder / "devices"
        self._nodes = {
            "can_driver": Node("can_driver", can),
            "watson_imu": Node("watson_imu", {"serial_port": str(devices / "watson")}),
            "sick_pls": Node("sick_pls", {"serial_port": str(devices / "sick")}),
            "box_localizer": Node("box_localizer", {"track_file": str(programs.folder / "track.json")}),
            "slip_estimator": Node("slip_estimator", {"state_file": str(programs.folder / "learned.yaml")}),
            "soil_estimator": Node("soil_estimator", {}),
            "record": Node("record", {}),
        }
        self._received = {topic: observer.subscribe(topic) for topic in OUTPUTS}
        self._truth, self._healths = [], observer.healths()
        observer.node.create_subscription(
            topic_class("truth/odometry"),
            "truth/odometry",
            lambda message, about: self._truth.append((message, about["source_timestamp"])),
            subscriber_qos("truth/odometry"),
        )
        self.estimates = self._received["odometry"]
        self.counted = self.published = 0
        drive = programs.folder / "to_and_fro.yaml"
        drive.write_text(to_and_fro("sand"), encoding="utf-8")
        programs.node("emulator", scenario=str(drive), duration=DRIVE_S, device_directory=str(devices), **can)
        observer.wait(lambda: (devices / "sick").exists(), "the devices", TRUTH_WITHIN_S)
        self._running = {name: self._start(name) for name in VICTIMS}
        self.wait_until_whole("the start")

    def _start(self, name):
        node = self._nodes[name]
        return self._programs.node(node.executable, **node.parameters)

    def kill(self, name):
        """Kill the node and start it again."""
        self._running[name].end(signal.SIGKILL)
        self._running[name] = self._start(name)

    def end(self, name):
        """Interrupt the node; its exit code must be 0."""
        assert self._running[name].end()[0] == 0

    def hold(self, name):
        """Suspend the node for some seconds."""
        process = self._running[name].process
        process.send_signal(signal.SIGSTOP)
        until = time.monotonic() + HELD_S
        self._observer.wait(lambda: time.monotonic() > until, "the node held")
        process.send_signal(signal.SIGCONT)

    def wait_until_whole(self, what):
        """Wait until all topics have current messages and the recorder reports; the duration, s."""
        began, began_ns = time.monotonic(), time.time_ns()
        give_up_s = began + PATIENCE
        self._healths.clear()
        while missing := self._missing(began_ns):
            assert time.monotonic() < give_up_s, f"after {what} missing: {missing}"
            self._observer.wait(
                lambda: not self._missing(began_ns) or time.monotonic() > give_up_s, "it", 2.0 * PATIENCE
            )
        return time.monotonic() - began

    def _missing(self, began_ns):
        """Topics without a current message, and the recorder if it has not reported."""
        silent = [topic for topic, received in self._received.items() if not _is_later(received, began_ns)]
        return silent + ([] if any(health.name == "record" for health in self._healths) else ["record"])

    def worst(self):
        """Largest error of all estimates since the last call, in standard deviations, with its component.

        Estimates after a delay of the emulator are excluded: killing and starting nodes can starve it.
        """
        truth = np.array([(*_estimate(m)[:4], at_ns - stamp_ns_of(m)) for m, at_ns in self._truth])
        rows = np.array([_estimate(m) for m in self.estimates])
        valid = (rows[:, 0] >= truth[0, 0]) & (rows[:, 0] <= truth[-1, 0])
        for late_ns in truth[truth[:, 4] > LATE_S * 1e9, 0]:
            valid &= (rows[:, 0] < late_ns - LATE_S * 1e9) | (rows[:, 0] > late_ns + SETTLED_S * 1e9)
        self.counted += valid.sum()
        self.published += len(valid)
        del self._truth[: -round(SETTLED_S * 100.0)]
        self.estimates.clear()
        if not valid.any():
            return 0.0, "the emulator was late"
        rows, since = rows[valid], truth[0, 0]
        actual = np.column_stack(
            [
                np.interp(rows[:, 0] - since, truth[:, 0] - since, values)
                for values in (truth[:, 1], truth[:, 2], np.unwrap(truth[:, 3]))
            ]
        )
        error = rows[:, 1:4] - actual
        error[:, 2] = np.arctan2(np.sin(error[:, 2]), np.cos(error[:, 2]))
        sigmas = np.abs(error) / rows[:, 4:]
        at, axis = np.unravel_index(np.argmax(sigmas), sigmas.shape)
        what = f"{error[at, axis]:.4f} ± {rows[at, 4 + axis]:.4f} in {('x', 'y', 'yaw')[axis]}"
        return float(sigmas[at, axis]), f"{what}, {(rows[-1, 0] - rows[at, 0]) * 1e-9:.1f} s ago"


def _is_later(messages, than_ns):
    return bool(messages) and stamp_ns_of(messages[-1]) > than_ns


def _estimate(message):
    """Stamp, ns, x, y, heading, and their standard deviations."""
    fix = pose_fix(message, "odometry")
    return fix.stamp_ns, *fix.pose, *np.sqrt(np.diagonal(fix.covariance))


def _differing_from_live(paths):
    """Differences between recordings and their replays; bags of killed recorders are recovered first."""
    differing, compared, published = {}, 0, 0
    for path in paths:
        try:
            live, estimates = _replayed(path)
        except InputError as error:  # killed before the first write to disk
            print(f"{path.name}: {error}")
            continue
        published += estimates
        if live is not None:
            breaks = [(round(at_ns * 1e-9), why) for at_ns, why in live.comparability.breaks]
            print(f"{path.name}: {live}; {len(live.comparability.parts)} parts, {breaks}", flush=True)
            compared += live.compared
            if live.compared and not live.matches:
                differing[path.name] = str(live)
    print(f"{compared} of {published} recorded estimates compared")
    assert compared > 0
    return differing


def _replayed(path):
    """Comparison of a recording with its replay, and the number of recorded estimates."""
    whole = path
    if not (path / METADATA).exists():
        whole = path.with_name(f"recovered_{path.name}")
        recover(path, whole)
    with open_bag(whole) as bag:
        estimates = sum(info.count for topic, info in bag.topics.items() if topic == "/odometry")
        return replay(bag, parameters_of(bag, [], []), InputFilters(), None).live, estimates


def test_nodes_use_no_shared_memory_ports(programs, observer):
    """A killed node leaves the lock of its shared-memory port, for which a sender waits; UDP has none."""
    adapter = programs.node("wheel_adapter")
    observer.wait_until_active("wheel_adapter")
    assert adapter.has_loaded("librmw_fastrtps")
    assert not any(adapter.has_loaded(f"{name}_port") for name in ("fastrtps", "fastdds"))


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_a_hundred_kills_in_a_row(programs, observer, can):
    graph, draw = Graph(programs, observer, can), random.Random(int(os.environ.get("TRACKSLIP_SEED", "1")))
    worst = {}
    for number in range(KILLS):
        name, action = draw.choice(VICTIMS), draw.choice((graph.kill, graph.hold))
        what = f"{number}: {action.__name__} {name}"
        action(name)
        whole_s = graph.wait_until_whole(what)
        worst[what], details = graph.worst()
        print(f"{what}: whole after {whole_s:.1f} s, {worst[what]:.2f} sigma ({details})", flush=True)
    graph.end("record")
    differing = _differing_from_live(sorted(programs.folder.glob("trackslip_*")))
    print(f"{graph.counted} of {graph.published} estimates counted: the emulator was in time")
    assert graph.counted > 0
    assert max(worst.values()) < WORST_SIGMAS, worst
    assert not differing, differing
