# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration of machine and sensors from drives: each value with its interval, or why there is none."""
