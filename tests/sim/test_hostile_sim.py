# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Hostile texts and full disks, given to the emulator and to ``trackslip simulate``."""

from collections.abc import Callable
from pathlib import Path

import pytest

from trackslip_common.errors import InputError
from trackslip_sim.machine.faults import parse_fault

FAULTS = {
    "a_bad_date": "{sensor: laser, kind: unplugged, start: 2026-13-45}",
    "5000_brackets": "[" * 5000,
    "a_huge_number": f"{{sensor: laser, kind: unplugged, start: {'7' * 5000}}}",
    "an_infinite_number": "{sensor: laser, kind: unplugged, start: 1e400}",
    "no_number": "{sensor: laser, kind: unplugged, start: .nan}",
    "a_list_for_a_name": "{sensor: [laser], kind: {a: b}}",
    "a_number_for_a_key": "{sensor: sick, kind: unplug, duration: 3.1,5}",
    "escapes": '{sensor: "\\e[2J", kind: unplugged}',
    "nothing": "",
}


@pytest.mark.parametrize("defect", FAULTS)
def test_a_hostile_fault_is_refused_in_one_line(defect: str) -> None:
    with pytest.raises(InputError) as refused:
        parse_fault(FAULTS[defect], 0.0)
    assert str(refused.value).isprintable()


@pytest.mark.usefixtures("full_disk")
def test_a_full_disk_leaves_nothing_of_simulate(tmp_path: Path, refuse: Callable[..., str]) -> None:
    options = ("--scenario", "straight", "--duration", "2", "--output", tmp_path / "bag")
    assert "cannot be written (No space left on device)" in refuse("simulate", *options)
    assert not list(tmp_path.iterdir())
