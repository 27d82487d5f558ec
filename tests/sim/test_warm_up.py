# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Compilation of the kernels before their first run."""

import pytest

from trackslip_sim.demo.warm_up import FAMILIES, main


@pytest.mark.parametrize("family", FAMILIES)
def test_every_family_compiles_and_reports_its_time(family: str, capsys: pytest.CaptureFixture[str]) -> None:
    main([family])
    assert capsys.readouterr().out.startswith(f"{family}: ")
