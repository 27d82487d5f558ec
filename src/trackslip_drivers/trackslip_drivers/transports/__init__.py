# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Ports and buses: the part of the drivers that blocks, fails, and reads clocks."""
