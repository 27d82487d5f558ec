# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Messages with arbitrary numbers on every topic; ``make fuzz`` takes a hundred thousand of each."""

import fuzz_messages


def test_slip_estimate_stays_finite_for_any_messages() -> None:
    result = fuzz_messages.fuzz_slip(400)
    assert result.faults == []
    for name in fuzz_messages.slip_topics():
        assert result.counts[f"{name} ACCEPTED"] > 0
        assert sum(n for text, n in result.counts.items() if text.startswith(f"{name} ")) == 400


def test_soil_estimate_stays_finite_for_any_messages() -> None:
    result = fuzz_messages.fuzz_soil(2000)
    assert result.faults == []
    assert all(result.counts[f"{name} contains nan or infinity"] > 0 for name in fuzz_messages.soil_topics())
    assert result.counts["machine_state beyond physical limits"] > 0
