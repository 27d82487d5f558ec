# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The angle of one count of the sprockets' encoders, from the positions of a log."""

from collections.abc import Sequence

from trackslip_bags.importing.samples import Samples
from trackslip_estimation.setup_check.counts import angle_of_count


def encoder_resolution(samples: Sequence[Samples]) -> float | None:
    """Rad; 0 of speeds, and of positions without counts; None without sprockets."""
    positions = next((one.values["position"] for one in samples if one.role == "sprockets"), None)
    return None if positions is None else angle_of_count(positions)
