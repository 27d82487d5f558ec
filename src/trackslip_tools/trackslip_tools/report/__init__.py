# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""One HTML page about a run, or about several side by side; it needs no network to be read."""
