# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Decoders of the sensors' bytes: bytes and arrival times in, records and counted rejections out."""
