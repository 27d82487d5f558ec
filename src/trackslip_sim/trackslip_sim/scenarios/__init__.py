# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Scenarios and terrains: commands of an operator, and the ground."""
