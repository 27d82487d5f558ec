# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Explanations that compete: branches of the estimate, their children, their weights."""
