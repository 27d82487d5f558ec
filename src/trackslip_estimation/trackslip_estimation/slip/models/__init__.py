# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Filters over a state with a mean and a covariance; they know nothing of the vehicle."""
