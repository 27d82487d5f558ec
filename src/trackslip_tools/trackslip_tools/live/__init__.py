# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The live page: what the machine does now, for a phone, a tablet or a desk, from a bag or from the graph."""
