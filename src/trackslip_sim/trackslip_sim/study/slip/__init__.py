# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""How good the slip estimator is on a known truth, and how good it could be."""
