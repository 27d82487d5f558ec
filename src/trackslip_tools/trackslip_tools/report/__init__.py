# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""One HTML page about a run or several side by side, readable without a network."""
