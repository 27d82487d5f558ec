# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Bank of competing hypotheses: branches of the estimate, their children, their weights."""
