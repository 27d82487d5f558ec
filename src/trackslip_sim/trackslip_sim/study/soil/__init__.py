# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""How good the soil estimator is on a known truth: ``trackslip study --estimator soil``."""
