# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip study``: how good the filters are on a known truth, and how good they could be."""
