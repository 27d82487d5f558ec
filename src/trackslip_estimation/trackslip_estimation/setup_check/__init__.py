# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Setup check: tracks, inertial unit and fixes are compared; mistakes that explain them are named."""
