# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Work at the desk: replay, smoothing, tuning, calibration, reports, and the command line."""
