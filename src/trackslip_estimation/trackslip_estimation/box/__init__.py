# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Pose of the box on the cab, from scans of a stationary laser on the site."""
