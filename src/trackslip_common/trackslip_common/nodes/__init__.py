# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The base of all nodes: lifecycle with autostart, checked parameters, diagnostics, quiet ends."""
