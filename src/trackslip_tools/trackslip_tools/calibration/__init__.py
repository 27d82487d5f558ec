# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What drives show of the machine and its sensors: each number with its interval, or why there is none."""
