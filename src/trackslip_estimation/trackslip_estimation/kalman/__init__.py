# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Kalman filters over a state with a mean and a covariance; independent of vehicle and sensors."""
