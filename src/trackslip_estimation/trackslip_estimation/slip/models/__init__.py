# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Motion models of the slip filter, and the effects that they share: slope, shear of the soil, swing."""
