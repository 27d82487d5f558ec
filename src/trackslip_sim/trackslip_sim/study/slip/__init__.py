# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of the slip estimator on a known truth, beside the posterior Cramér–Rao bound."""
