# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What a motion model says of itself; a new one needs its own file and its lines in the dispatch, no more."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from fixtures.patience import PATIENCE

import trackslip_estimation
from trackslip_estimation.slip.models import dispatch
from trackslip_estimation.slip.models.model import FIX_DELAY, GYRO_SCALE, SIZE

PACKAGE = Path(trackslip_estimation.__file__).parent

TOY = '''
"""A machine that pulls to one side: ω = κ D/B + p V, v = (1 − i₀) V."""

from typing import Any

import numpy as np

from trackslip_common.compiled import compiled
from trackslip_estimation.slip.models import speed
from trackslip_estimation.slip.models.model import Part
from trackslip_estimation.slip.models.speed import COMMON_SLIP, FIRST, SECOND

CODE, NAME, ACTIVE = 3, "toy", speed.ACTIVE
NOISE = "turning"  # it has no numbers of its own
EFFICIENCY, PULL = FIRST, SECOND
PARTS = (
    *speed.PARTS,
    Part("efficiency", slice(EFFICIENCY, EFFICIENCY + 1), "1", "turning efficiency κ"),
    Part("pull", slice(PULL, PULL + 1), "rad/m", "turn for each metre of the way"),
)


def prior(n, tread):
    start = speed.prior(n, tread)
    start.mean[EFFICIENCY], start.stddev[EFFICIENCY], start.stddev[PULL] = 0.6, 0.1, 0.2
    return start


def process_noise_density(n, motion):
    return speed.process_noise_density(n, motion)


def velocity_error_constants(n):
    return speed.constants(n, (0.1, 0.2))


@compiled
def twist(x, left, right, c):
    V, D = c.rolling_radius * (left + right) / 2.0, c.rolling_radius * (right - left)
    return speed.twist(x, (1.0 - x[COMMON_SLIP]) * V, x[EFFICIENCY] * D / c.tread + x[PULL] * V)


@compiled
def twist_jacobian(x, left, right, c):
    V, D = c.rolling_radius * (left + right) / 2.0, c.rolling_radius * (right - left)
    J = np.zeros((3, x.size))
    J[0, COMMON_SLIP], J[2, EFFICIENCY], J[2, PULL] = -V, D / c.tread, V
    speed.complete_jacobian(x, x[EFFICIENCY] * D / c.tread + x[PULL] * V, J)
    return J
'''

DISPATCH = (  # what stands there, and what stands there with one more model
    (
        "import free_slips, icr, slope, speed, turning\n",
        "import free_slips, icr, slope, speed, toy, turning\n",
    ),
    ("(turning, icr, free_slips)}\n", "(turning, icr, free_slips, toy)}\n"),
    *(
        (before, before + f"    if c.model == toy.CODE:\n        return toy.{name}(x, left, right, c)\n")
        for name in ("twist", "twist_jacobian")
        for before in (f"        return turning.{name}(x, left, right, c)\n",)
    ),
)

DRIVE = '''
import math
from types import SimpleNamespace

import numpy as np

from trackslip_estimation.slip.config import make_config
from trackslip_estimation.slip.measurements import Outcome, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip.models import toy
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.records import STATE, UPDATE, to_records
from trackslip_estimation.slip.step import step

PULL, STEP = 0.1, 0.05  # rad/m, s


def fields(record):
    """A record as compiled code sees it, for Python: its arrays are those of the record."""
    if isinstance(record, np.ndarray) and record.dtype.names:
        return [fields(one) for one in record]
    if not isinstance(record, np.void):
        return record
    return SimpleNamespace(**{name: fields(record[name]) for name in record.dtype.names})


p = load_slip_parameters({"model": "toy"})
c = fields(make_config(p)[0])
state, update = fields(np.zeros(1, STATE)[0]), fields(np.zeros(1, UPDATE)[0])
state.mean[:], state.covariance[:] = c.prior_mean, c.prior_covariance
state.covariance[:3, :3] = np.diag((0.01, 0.01, 0.01)) ** 2
state.outlier_share[:] = 0.01
assert state.mean[toy.PULL] == 0.0
way = p.vehicle.kinematics.rolling_radius * 2.0 * STEP
pose, outcomes, rng = np.zeros(3), [], np.random.default_rng(0)
for k in range(160):
    stamp_ns = round(k * STEP * 1e9)
    found = [Sprockets("sprockets", stamp_ns, 2.0, 2.0, (2.0 * STEP * k, 2.0 * STEP * k))]
    if k:
        halfway = pose[2] + PULL * way / 2.0
        pose = pose + np.array((way * math.cos(halfway), way * math.sin(halfway), PULL * way))
        found.append(YawRate("imu/data_raw", stamp_ns, PULL * way / STEP + 0.005 * rng.normal(), 0.005**2))
    if k % 10 == 9:
        sigma = np.array((0.03, 0.03, 0.02))
        found.append(PoseFix("box_pose", stamp_ns, pose + sigma * rng.normal(size=3), np.diag(sigma**2)))
    records = [fields(one) for one in to_records(found, {"box_pose": 0, "imu/data_raw": 1})]
    for record in records:
        step(state, records[0], record, c, update)
        outcomes.append(update.outcome)
assert outcomes.count(Outcome.ACCEPTED) > 0.98 * len(outcomes), outcomes
error = np.abs(state.mean[:3] - pose)
assert (error < 4.0 * np.sqrt(np.diag(state.covariance)[:3])).all(), error
assert error[:2].max() < 0.06, error
deviation = math.sqrt(state.covariance[toy.PULL, toy.PULL])
assert deviation < 0.1, deviation
assert abs(state.mean[toy.PULL] - PULL) < 0.05 > 0.5 * deviation, state.mean[toy.PULL]
print("drove", len(outcomes))
'''


@pytest.mark.parametrize("model", dispatch.MODELS.values(), ids=list(dispatch.MODELS))
def test_the_named_parts_cover_the_state_once_each_number_with_its_unit(model: ModuleType) -> None:
    numbers = [k for part in model.PARTS for k in range(SIZE)[part.at]]
    of_all = {GYRO_SCALE, FIX_DELAY}  # the thesis' model knows them, and has them at 0
    assert sorted(numbers) == sorted({*range(model.ACTIVE)} | of_all)
    assert len({part.name for part in model.PARTS}) == len(model.PARTS)
    for part in model.PARTS:
        units = [unit.strip() for unit in part.unit.split(",")]
        assert len(units) == len(range(SIZE)[part.at])
        assert all(units)
        assert part.meaning


def test_models_have_codes_and_names_of_their_own() -> None:
    assert len({model.CODE for model in dispatch.MODELS.values()}) == len(dispatch.MODELS)
    assert all(name == model.NAME for name, model in dispatch.MODELS.items())


def test_a_new_model_is_one_file_and_its_lines_in_the_dispatch(tmp_path: Path) -> None:
    """In a copy of the package, not compiled, over 8 s."""
    copy = tmp_path / "trackslip_estimation"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    (copy / "slip/models/toy.py").write_text(TOY, encoding="utf-8")
    text = (copy / "slip/models/dispatch.py").read_text(encoding="utf-8")
    for before, after in DISPATCH:
        assert text.count(before) == 1, before
        text = text.replace(before, after)
    (copy / "slip/models/dispatch.py").write_text(text, encoding="utf-8")
    path = os.pathsep.join(filter(None, sys.path))
    done = subprocess.run(
        [sys.executable, "-c", DRIVE],
        cwd=tmp_path,  # where python -c looks first: colcon runs tests beside the package itself
        env=os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("drove")
