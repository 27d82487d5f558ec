# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Soil and forces: thrusts from pressures, resistance from motion, strength from slip and thrust."""
