# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Setup check: three odometers (tracks, inertial unit, fixes) are compared, and the mistake that explains them is named."""
