# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of GNSS fixes to poses in metres."""
