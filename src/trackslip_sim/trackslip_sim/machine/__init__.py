# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The emulated excavator: vehicle, hydraulics, sensors, and their faults."""
