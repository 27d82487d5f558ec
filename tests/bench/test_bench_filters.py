# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The bench of filters runs a whole drive through an external filter."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import bench_filters


class FilterpyStub:
    """The part of ``filterpy.kalman.ExtendedKalmanFilter`` that the bench uses."""

    updates = 0

    def __init__(self, size: int, rows: int) -> None:
        assert rows == 1
        self.x = np.zeros(size)
        self.P = self.F = self.Q = np.eye(size)

    def predict(self) -> None:
        self.x, self.P = self.F @ self.x, self.F @ self.P @ self.F.T + self.Q

    def update(self, z: Any, jacobian: Any, expected: Any, R: Any) -> None:
        H = jacobian(self.x)
        gain = self.P @ H.T @ np.linalg.inv(H @ self.P @ H.T + R)
        self.x, self.P = (
            self.x + gain @ (z - expected(self.x)),
            (np.eye(self.x.size) - gain @ H) @ self.P,
        )
        FilterpyStub.updates += 1


def test_filter_bench_runs_to_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_filters, "ROWS", 400)
    monkeypatch.setattr(FilterpyStub, "updates", 0)
    seconds = bench_filters._filterpy(
        SimpleNamespace(ExtendedKalmanFilter=FilterpyStub), bench_filters._drive()
    )
    assert seconds > 0.0
    assert FilterpyStub.updates == 200
