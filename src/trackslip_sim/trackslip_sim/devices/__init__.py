# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Emulated devices that send and receive the bytes of the real ones; time is an argument, no ports."""
