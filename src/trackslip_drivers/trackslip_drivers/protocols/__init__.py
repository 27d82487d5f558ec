# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What the sensors' bytes mean: bytes and an arrival time in, records and counted rejections out."""
