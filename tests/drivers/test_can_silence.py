# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Motion during a silence of the bus is neither invented nor lost."""

import itertools
import math

import numpy as np
import pytest
from fixtures.excavator_bus import CYCLE_NS, FRAMES, PARAMETERS

from trackslip_common.tally import Tally
from trackslip_drivers.protocols.excavator_can import ExcavatorCan
from trackslip_drivers.records import HydraulicsSample, SprocketSample
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Sprockets
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_sim.devices.can_device import CanDevice

S = 1_000_000_000
START = {"start": "initial_pose"}
OFF_S = 1.5


def speeds(t):
    """Left and right sprocket speed, rad/s: from standstill to a turn with the lag of a valve."""
    rise = 1.0 - np.exp(-t / 0.15)
    return 2.4 * rise, 1.1 * rise


def turned(t):
    return tuple(speed * (t - 0.15 * (1.0 - np.exp(-t / 0.15))) for speed in (2.4, 1.1))


def sprockets(stamp_ns):
    t = max(stamp_ns - S, 0) * 1e-9
    return SprocketSample(stamp_ns, *turned(t), *speeds(t))


def hydraulics(stamp_ns):
    return HydraulicsSample(stamp_ns, 0.0, 0.0, 0.0, 0.0, 0.0)


def received(silence_s, *, reopened=True, restarted=False):
    """Samples of a drive of 3 s; the bus is off for ``silence_s`` in the middle."""
    device, driver = CanDevice(FRAMES, sprockets, hydraulics, S), ExcavatorCan(PARAMETERS, FRAMES, Tally())
    off_ns, samples, was_off = round((1.0 + OFF_S) * S), [], False
    for now_ns in range(S, 4 * S + 1, CYCLE_NS):
        sent = device.step(now_ns)
        if off_ns <= now_ns < off_ns + silence_s * S:
            was_off = True
            continue
        if was_off and reopened:
            driver.resume()
        if was_off and restarted:
            device.start(now_ns)  # the device's counter restarts
            sent = device.step(now_ns)
        was_off = False
        for frame in sent:
            samples += [one for one in driver.receive(*frame, now_ns) if isinstance(one, SprocketSample)]
    return samples


@pytest.fixture(scope="module")
def whole():
    """The samples of the drive without a silence."""
    return received(0.0)


def heading(samples):
    """Final heading of an estimator that receives these sprocket samples alone, rad."""
    estimator = SlipEstimator(load_slip_parameters(START, {}))
    for s in samples:
        estimate = estimator.process(Sprockets("sprockets", s.stamp_ns, s[3], s[4], (s[1], s[2])))[1] or None
    assert estimate is not None
    assert estimate.stamp_ns == 4 * S
    return math.degrees(estimate.pose[2])


@pytest.mark.parametrize("silence_s", [0.05, 0.3, 0.45])
@pytest.mark.parametrize(
    "how", [{}, {"reopened": False}, {"restarted": True}], ids=["reopened", "silent", "reset"]
)
def test_heading_is_kept_over_a_bus_off_of_up_to_450_ms(whole, silence_s, how):
    """Positions agree with those of the drive without a silence."""
    broken = received(silence_s, **how)
    assert heading(broken) == pytest.approx(heading(whole), abs=0.15)
    assert broken[-1][1:3] == pytest.approx(whole[-1][1:3], abs=2e-3)
    assert len(whole) - len(broken) <= silence_s * 100 + 1


def test_sample_after_a_long_silence_has_no_position(whole):
    broken = received(0.9)
    known = [s for s in broken if not math.isnan(s.left_position)]
    assert len(broken) - len(known) == 1
    before = next(s for s in broken if math.isnan(s.left_position))
    assert before.left_velocity == pytest.approx(2.4, abs=0.1)
    for a, b in itertools.pairwise(known):
        if a.stamp_ns < before.stamp_ns < b.stamp_ns:
            continue  # the estimator does not pair two samples across one without a position
        assert b.left_position - a.left_position == pytest.approx(
            2.4 * (b.stamp_ns - a.stamp_ns) * 1e-9, abs=0.04
        )
    assert whole[-1].left_position != pytest.approx(broken[-1].left_position, abs=1.0)
