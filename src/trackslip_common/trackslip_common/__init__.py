# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Shared by all Trackslip packages: validated parameters, errors, counts, and the base of the nodes."""

__version__ = "0.1.0"
