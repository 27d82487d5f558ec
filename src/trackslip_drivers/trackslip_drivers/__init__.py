# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Drivers of the sensors, from bytes to messages: protocols, transports, nodes."""
