# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Constants common to the live emulator and the offline simulation."""

TICK_NS = 2_000_000  # time step of the serial lines
TRUTH_NS = 10_000_000  # period of the truth's messages
SWING_NS = 20_000_000  # period of the swing encoder and of its truth
FORCES_NS = 100_000_000
SOIL_NS = 1_000_000_000
DRAIN_NS = 1_000_000_000  # after the end of the drive, for bytes still on the lines
SITE_FRAME, BODY_FRAME = "map", "base_link"
