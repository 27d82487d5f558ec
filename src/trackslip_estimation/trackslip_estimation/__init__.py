# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Where the tracked machine is, how much each track slips, and what the ground is like."""
