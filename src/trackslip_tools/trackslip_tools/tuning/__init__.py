# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Finds parameters with which the estimator explains drives best, and evaluates them by cross-validation."""
