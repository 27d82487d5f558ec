# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip study``: errors of the estimators on a known truth, beside their lower bounds."""
