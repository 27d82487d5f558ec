# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Offline tools: replay, smoothing, tuning, calibration, reports, and the command line."""
