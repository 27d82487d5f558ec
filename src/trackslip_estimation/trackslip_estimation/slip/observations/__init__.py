# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Observation models: innovation, Jacobian and noise of each kind of measurement, one module a kind."""
