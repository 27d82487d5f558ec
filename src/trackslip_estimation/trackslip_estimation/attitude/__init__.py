# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Roll, pitch and height of the machine from one IMU and the speed of its tracks."""
