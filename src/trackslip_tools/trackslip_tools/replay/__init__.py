# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Runs the estimator over a bag, in process and without a network, exactly as it ran live."""
