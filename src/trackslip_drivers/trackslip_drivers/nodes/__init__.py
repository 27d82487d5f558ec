# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Driver nodes: each owns a port, and publishes the records that the protocols decode."""
