# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What an excavator that is emulated live has in common with one that is simulated offline."""

TICK_NS = 2_000_000  # how finely the serial lines are dripped
TRUTH_NS = 10_000_000  # from one message of the truth to the next
SWING_NS = 20_000_000  # of the encoder, and of its truth
FORCES_NS = 100_000_000
SOIL_NS = 1_000_000_000
DRAIN_NS = 1_000_000_000  # after the end of the drive, for what is still on the lines
SITE_FRAME, BODY_FRAME = "map", "base_link"
