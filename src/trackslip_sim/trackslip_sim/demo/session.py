# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The live part of the demo: starts the nodes, activates the emulator, shows the drive."""

import time
from collections import Counter
from collections.abc import Callable, Sequence

from rich.console import Console
from rich.live import Live
from rich.text import Text

from trackslip_sim.demo.graph import NodeSpec
from trackslip_sim.demo.processes import DemoFailure, Processes
from trackslip_sim.demo.show import status
from trackslip_sim.nodes.demo_monitor import DemoMonitor, join_graph, leave_graph

_CONFIGURE_TIMEOUT = 180.0  # s, longest preparation of the drive; the first run compiles its kernels
_DISCOVERY_TIMEOUT = 60.0  # s for the nodes to find each other, on a busy machine
_LINE_PERIOD = 0.5  # s
_PLAIN_PERIOD = 5.0  # s, if the output is not a terminal
_RATE_TOPICS = ("sprockets", "imu/data_raw", "scan", "fix", "odometry")  # topics of the status line
_CHECK_PERIOD = 0.2  # s between checks that the nodes still run
_MAX_END_DELAY = 30.0  # s, longest delay of the drive's end


class Session:
    """One drive; afterwards ``monitor`` has its counts."""

    def __init__(self, processes: Processes, console: Console, check: Callable[[], None]) -> None:
        self._check = check  # raises KeyboardInterrupt after Ctrl-C
        self._processes = processes
        self._console = console
        join_graph()
        self.monitor = DemoMonitor()

    def bring_up(self, nodes: Sequence[NodeSpec]) -> None:
        """Start the nodes, wait until they are connected and their ports open, activate the emulator.

        Raises:
            DemoFailure: a node does not start in time.
        """
        self._console.print(f"starting {len(nodes)} nodes …")
        for node in nodes:
            self._check()
            self._processes.start(node)
        self._change_emulator_state("configure", self.monitor.configure_emulator, _CONFIGURE_TIMEOUT)
        until = time.monotonic() + _DISCOVERY_TIMEOUT
        running = {node.executable for node in nodes}
        drivers = {node.executable for node in nodes if node.package == "trackslip_drivers"}
        while missing := self.monitor.missing_endpoints(running) | drivers - self.monitor.healthy_nodes:
            self._check_processes()
            if time.monotonic() > until:
                raise DemoFailure(f"nodes did not find each other: {', '.join(sorted(missing))}")
            self.monitor.spin_for(0.05)
        self._change_emulator_state("start", self.monitor.activate_emulator, _DISCOVERY_TIMEOUT)

    def show_drive(self, duration: float) -> None:
        """Show the drive until the emulator reports its end.

        Raises:
            DemoFailure: a node ended, or the emulator did not finish in time.
        """
        began = shown_s = time.monotonic()
        until = began + duration + _MAX_END_DELAY
        received = self.monitor.received
        before = Counter(received)
        terminal = self._console.is_terminal
        period = _LINE_PERIOD if terminal else _PLAIN_PERIOD
        with Live(console=self._console, auto_refresh=False, transient=True) as live:
            while not self.monitor.finished:
                self.monitor.spin_for(0.1)
                self._check_processes()
                now = time.monotonic()
                if now > until:
                    raise DemoFailure(f"emulator: not finished {_MAX_END_DELAY:g} s after the drive's end")
                if now - shown_s < period:
                    continue
                topics = [topic for topic in _RATE_TOPICS if received[topic]]
                rates = {topic: (received[topic] - before[topic]) / (now - shown_s) for topic in topics}
                line = status(now - began, self.monitor.pose, self.monitor.slips, rates)
                shown_s, before = now, Counter(received)
                if terminal:
                    live.update(Text(line, no_wrap=True, overflow="ellipsis"), refresh=True)
                else:
                    print(line, flush=True)

    def close(self) -> None:
        """Leave the graph."""
        self.monitor.close()
        leave_graph()

    def _change_emulator_state(self, verb: str, request: Callable[[float], bool], timeout: float) -> None:
        until = time.monotonic() + timeout
        while not request(_CHECK_PERIOD):
            self._check_processes()
            if time.monotonic() > until:
                last = self._processes.log("emulator")[-300:] or "(no output)"
                raise DemoFailure(f"emulator did not {verb} within {timeout:g} s: {last}")

    def _check_processes(self) -> None:
        """Raise KeyboardInterrupt after Ctrl-C, DemoFailure after the end of a needed node."""
        self._check()
        for name, code in self._processes.exit_codes().items():
            last = (self._processes.log(name).splitlines() or ["(no output)"])[-1]
            raise DemoFailure(f"{name} ended with exit code {code}: {last}")
