# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Setup check: compares tracks, inertial unit and fixes, and names mistakes that explain differences."""
