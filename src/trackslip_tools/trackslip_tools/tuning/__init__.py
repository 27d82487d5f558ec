# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Finds the parameters with which the estimator explains drives best, and shows what that is worth."""
