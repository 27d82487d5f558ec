# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Where the laser box on the cab is, from scans of a laser that stands on the site."""
