# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Cost of the live page: a driving machine in the graph, the node ``live``, and connected pages.

``python tests/bench/bench_live.py [--minutes 5] [--pages 3] [--chromium]`` (source .venv/trackslip.sh before)
plays a synthetic drive at the rates of the real nodes. It prints the node's share of a core, its memory over
time, and the number of frames of each page. A page is a websocket that decodes its frames; with
``--chromium`` it is a browser as wide as a phone, a tablet or a desktop, and its console is printed too.
"""

import argparse
import asyncio
import json
import math
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from tornado.websocket import websocket_connect
from trackslip_msgs.msg import SoilEstimate, TrackForces, TrackSlip

PORT = 5996
WIDTHS = (390, 1024, 1440)  # pixels of a phone, a tablet and a desktop
TICKS = os.sysconf("SC_CLK_TCK")
PAGE_B = os.sysconf("SC_PAGE_SIZE")
DRIVERS = ("can_driver", "watson_imu", "sick_pls")
ESTIMATORS = ("box_localizer", "slip_estimator", "soil_estimator", "record")
SETTLING_S = 20.0  # s after the start
SHOWN: dict[str, Any] = {}  # the newest frame

Visit = Callable[[list[int], int], Awaitable[None]]  # a page: counts its frames in its element of the list


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--pages", type=int, default=3)
    parser.add_argument("--chromium", action="store_true", help="pages of a real browser")
    options = parser.parse_args()
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    start = "from trackslip_tools.nodes.live import main; main()"
    command = [sys.executable, "-c", start, "--ros-args", "-p", f"port:={PORT}"]
    stop = threading.Event()
    feeder = threading.Thread(target=drive, args=(stop,))
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as node:
        feeder.start()
        try:
            visit = browse if options.chromium else read_frames
            asyncio.run(measure(node.pid, options.minutes * 60.0, options.pages, visit))
        finally:
            stop.set()
            feeder.join()
            node.terminate()
    return 0


def drive(stop: threading.Event) -> None:
    """Publish the messages of a machine's nodes at their rates."""
    rclpy.init()
    node = rclpy.create_node("bench")
    kinds = {
        "odometry": Odometry,
        "track_slip": TrackSlip,
        "track_forces": TrackForces,
        "soil": SoilEstimate,
        "box_pose": PoseWithCovarianceStamped,
        "/diagnostics": DiagnosticArray,
    }
    outlets = {topic: node.create_publisher(kind, topic, 100) for topic, kind in kinds.items()}
    step, began = 0, time.monotonic()
    while not stop.wait(max(0.0, began + 0.01 * step - time.monotonic())):
        for topic, message in messages_at(step):
            outlets[topic].publish(message)
        step += 1
    node.destroy_node()
    rclpy.shutdown()


def messages_at(step: int) -> list[tuple[str, Any]]:
    """(topic, message) pairs of the step-th hundredth of a second."""
    t = 0.01 * step
    odometry = Odometry()
    odometry.pose.pose.position.x, odometry.pose.pose.position.y = 0.4 * t, 5.0 * math.sin(0.05 * t)
    odometry.pose.pose.orientation.w = 1.0
    odometry.pose.covariance[0] = odometry.pose.covariance[7] = 1e-4
    slip = TrackSlip(left_slip=0.1 + 0.1 * math.sin(t), right_slip=0.02, motion_state=TrackSlip.STRAIGHT)
    messages: list[tuple[str, Any]] = [("odometry", odometry), ("track_slip", slip)]
    if step % 10 == 0:
        messages.append(
            ("track_forces", TrackForces(left_thrust=2000.0 * math.sin(t), left_thrust_reserve=0.5))
        )
    if step % 24 == 0:
        fix = PoseWithCovarianceStamped()
        fix.pose.pose.position.x, fix.pose.pose.orientation.w = 0.4 * t, 1.0
        messages.append(("box_pose", fix))
    if step % 100 == 0:
        messages.append(("soil", SoilEstimate(shear_modulus=0.01, shear_modulus_upper=0.02)))
        messages += [("/diagnostics", diagnostics(name, step)) for name in (*DRIVERS, *ESTIMATORS)]
    return messages


def diagnostics(name: str, step: int) -> DiagnosticArray:
    values = [KeyValue(key=f"count {k}", value=str(step)) for k in range(20)]
    status = DiagnosticStatus(name=name, message="running", values=values, hardware_id=name)
    return DiagnosticArray(status=[status])


async def measure(pid: int, seconds: float, pages: int, visit: Visit) -> None:
    """Print CPU and memory of the process while pages are connected."""
    counts = [0] * pages
    tasks = [asyncio.ensure_future(visit(counts, k)) for k in range(pages)]
    await asyncio.sleep(SETTLING_S)
    began, used, first = time.monotonic(), cpu_s(pid), list(counts)
    print(f"{'minutes':>8}{'core, %':>9}{'memory, MB':>12}", flush=True)
    report_s = min(max(seconds / 10.0, 5.0), 60.0)
    while time.monotonic() - began < seconds:
        await asyncio.sleep(report_s)
        now_s, now_used = time.monotonic(), cpu_s(pid)
        share = 100.0 * (now_used - used) / (now_s - began)
        print(f"{(now_s - began) / 60.0:8.1f}{share:9.1f}{memory_b(pid) / 1e6:12.1f}", flush=True)
    rates = [
        (count - before) / (time.monotonic() - began) for count, before in zip(counts, first, strict=True)
    ]
    print("frames a second of each page:", *(f"{rate:.2f}" for rate in rates))
    print(f"shown at the end: {SHOWN}")
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


async def read_frames(counts: list[int], number: int) -> None:
    """A page: connects with retries and decodes all frames."""
    while True:
        try:
            page = await websocket_connect(f"ws://127.0.0.1:{PORT}/stream")
        except OSError:
            await asyncio.sleep(0.5)
            continue
        while (text := await page.read_message()) is not None:
            frame = json.loads(text)
            SHOWN.update(position=frame["facts"]["position"], lights=len(frame["lights"]))
            counts[number] += 1


async def browse(counts: list[int], number: int) -> None:
    """A page in a browser; polled each second for its number of shown frames."""
    from playwright.async_api import Error, async_playwright

    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        page = await browser.new_page(viewport={"width": WIDTHS[number % len(WIDTHS)], "height": 800})
        page.on("console", lambda message: print(f"page {number}: {message.type}: {message.text}"))
        page.on("pageerror", lambda error: print(f"page {number}: {error}"))
        while True:
            try:
                await page.goto(f"http://127.0.0.1:{PORT}/")
                break
            except Error:  # the node does not serve yet
                await asyncio.sleep(0.5)
        while True:
            await asyncio.sleep(1.0)
            counts[number] = await page.evaluate("Number(document.documentElement.dataset.frames ?? 0)")
            SHOWN["position"] = await page.inner_text('[data-fact="position"]')


def cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def memory_b(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * PAGE_B


if __name__ == "__main__":
    sys.exit(main())
