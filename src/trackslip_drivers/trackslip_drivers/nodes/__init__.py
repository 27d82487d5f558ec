# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Driver nodes: thin shells that own a port and publish what the protocols make of its bytes."""
