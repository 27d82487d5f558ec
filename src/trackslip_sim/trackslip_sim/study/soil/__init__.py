# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of the soil estimator on a known truth: ``trackslip study --estimator soil``."""
