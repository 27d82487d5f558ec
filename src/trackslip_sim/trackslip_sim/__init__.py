# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Emulated excavator: truth models, sensor models, and devices that send real bytes."""
