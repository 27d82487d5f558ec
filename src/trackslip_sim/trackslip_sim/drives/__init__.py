# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Random drives of random machines, in and out of the laser's sight, and what the estimator makes of them."""
