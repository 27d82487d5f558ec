# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The slip estimator: pose, slip of each track and slip angle from any measurements, in any order."""
