# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What each kind of measurement says of the state: one file a kind, each with a function that observes."""
