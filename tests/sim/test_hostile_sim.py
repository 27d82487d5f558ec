# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Hostile texts and full disks, given to the emulator and to ``trackslip simulate``."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from trackslip_common.errors import InputError
from trackslip_sim.machine.faults import parse_fault

FAULTS = {  # defect → text, and what the refusal names
    "a_bad_date": ("{sensor: sick, kind: unplug, start: 2026-13-45, duration: 1}", "not YAML"),
    "5000_brackets": ("[" * 5000, "nested too deep"),
    "a_huge_number": (f"{{sensor: sick, kind: unplug, start: {'7' * 5000}, duration: 1}}", "beyond 64 bits"),
    "an_infinite_start": ("{sensor: sick, kind: unplug, start: 1e400, duration: 1}", "start = inf"),
    "no_number_for_a_start": ("{sensor: sick, kind: unplug, start: .nan, duration: 1}", "start = nan"),
    "no_number_for_a_duration": ("{sensor: sick, kind: unplug, duration: .nan}", "duration = nan"),
    "no_number_for_a_value": ("{sensor: sick, kind: glare, duration: 1, value: .nan}", "value = nan"),
    "a_list_for_a_name": ("{sensor: [sick], kind: {a: b}, duration: 1}", "sensor = ['sick']"),
    "a_number_for_a_key": ("{sensor: sick, kind: unplug, duration: 3.1,5}", "unknown key '5'"),
    "escapes": ('{sensor: "\\e[2J", kind: unplug, duration: 1}', "has no unplug"),
    "nothing": ("", "accepted: a mapping"),
    "a_list": ("[1]", "accepted: a mapping"),
    "an_open_bracket": ("{", "not YAML"),
    "no_kind": ("{sensor: can}", "kind = None is missing"),
}


@pytest.mark.parametrize("defect", FAULTS)
def test_a_hostile_fault_is_refused_for_its_defect_in_one_line(defect: str) -> None:
    text, reason = FAULTS[defect]
    with pytest.raises(InputError, match=re.escape(reason)) as refused:
        parse_fault(text, 0.0)
    assert str(refused.value).isprintable()


@pytest.mark.usefixtures("full_disk")
def test_a_full_disk_leaves_nothing_of_simulate(tmp_path: Path, refuse: Callable[..., str]) -> None:
    options = ("--scenario", "straight", "--duration", "2", "--output", tmp_path / "bag")
    assert "cannot be written (No space left on device)" in refuse("simulate", *options)
    assert not list(tmp_path.iterdir())
