# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The node ``live`` with 2000 hostile connections and 256 file descriptors answers, and logs little."""

import http.client
import re
import signal
import time
from pathlib import Path

import pytest
from fixtures import flood
from fixtures.patience import PATIENCE
from fixtures.programs import ros_arguments

STRANGERS, DESCRIPTORS = 2000, 256
PRINTED = r"http://\S+:(\d+)/"
LIMITED = f'ulimit -n {DESCRIPTORS} && exec "$@"'


def seconds_until_answered(port: int, path: str) -> float:
    began = time.monotonic()
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE)
    connection.request("GET", path)
    answer = connection.getresponse()
    assert answer.status == 200
    assert len(answer.read()) == int(answer.headers["Content-Length"])
    connection.close()
    return time.monotonic() - began


@pytest.mark.soak  # beside other tests the machine is too busy to judge the answers by
@pytest.mark.parametrize("duration_s", [60.0])
def test_page_answers_good_clients_among_2000_bad_ones(programs, duration_s):
    node = programs.start("sh", "-c", LIMITED, "sh", programs.path("live"), *ros_arguments(port=0))
    node.until(lambda: re.search(PRINTED, node.stdout + node.stderr), "the address")
    port = int(re.findall(PRINTED, node.stdout + node.stderr)[0])
    lines_before = len((node.stdout + node.stderr).splitlines())
    strangers = programs.python(str(Path(flood.__file__)), str(port), str(STRANGERS))
    began, answered_s = time.monotonic(), []
    while time.monotonic() < began + duration_s or len(answered_s) < 9:
        assert strangers.process.poll() is None, strangers.stderr
        answered_s.append(seconds_until_answered(port, ("/", "/live.js", "/page.json")[len(answered_s) % 3]))
        time.sleep(0.1)
    lines = len((node.stdout + node.stderr).splitlines()) - lines_before
    lasted_s = time.monotonic() - began
    answered_s.sort()
    print(
        f"{STRANGERS} bad connections for {lasted_s:.0f} s: {len(answered_s)} good requests answered within "
        f"{answered_s[-1]:.2f} s (median {answered_s[len(answered_s) // 2]:.3f} s), {lines} lines of log"
    )
    assert lines <= 1 + lasted_s
    strangers.end(signal.SIGKILL)
