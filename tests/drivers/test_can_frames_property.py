# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""CAN frames: round trips are exact to the resolution; arbitrary bytes raise no exception in the decoder."""

from typing import Any

import pytest
from fixtures.excavator_bus import FRAMES, PARAMETERS
from hypothesis import given, settings
from hypothesis import strategies as st

from trackslip_common.tally import Tally
from trackslip_drivers.protocols.can_frames import FrameDecoder
from trackslip_drivers.protocols.excavator_can import ExcavatorCan
from trackslip_sim.devices.can_device import ENCODERS, PRESSURES, SPOOLS

IDS = [message.frame_id for message in FRAMES.by_name.values()]
PRESSURE = st.floats(-25e6, 25e6)
READINGS = st.one_of(
    st.tuples(
        st.just(ENCODERS),
        st.fixed_dictionaries({"left_count": st.integers(0, 4095), "right_count": st.integers(0, 4095)}),
        st.just(0.0),
    ),
    st.tuples(
        st.just(SPOOLS),
        st.fixed_dictionaries({"left_spool": st.floats(-1, 1), "right_spool": st.floats(-1, 1)}),
        st.just(0.5e-4),
    ),
    st.tuples(
        st.just(PRESSURES),
        st.fixed_dictionaries(
            {"left_pressure": PRESSURE, "right_pressure": PRESSURE, "supply_pressure": st.floats(0, 25e6)}
        ),
        st.just(500.0),
    ),
)
seeded = settings(derandomize=True, max_examples=200, deadline=None)


@seeded
@given(READINGS, st.integers(0, 1000))
def test_round_trip_within_half_the_resolution(reading, alive):
    name, values, half_step = reading
    decoded: Any = FrameDecoder(FRAMES, Tally()).decode(*FRAMES.encode(name, values, alive), 0)
    (frame,) = decoded
    assert frame.values == pytest.approx(values, abs=half_step * 1.000001)


@seeded
@given(
    st.lists(
        st.tuples(
            st.one_of(st.sampled_from(IDS), st.integers(0, 2**32 - 1)),
            st.binary(max_size=64),
            st.integers(-(2**62), 2**62),
        ),
        max_size=50,
    )
)
def test_no_bus_breaks_the_decoder(received):
    excavator = ExcavatorCan(PARAMETERS, FRAMES, Tally())
    for arbitration_id, data, stamp_ns in received:
        excavator.receive(arbitration_id, data, stamp_ns)
    counted = sum(excavator.tally.total.values()) + excavator.decoder.frames_without_role
    assert counted >= len([1 for identifier, _, _ in received if identifier not in IDS])
