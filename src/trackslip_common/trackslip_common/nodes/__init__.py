# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Base of all nodes: lifecycle with autostart, checked parameters, diagnostics, clean shutdown."""
