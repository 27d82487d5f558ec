# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The setup check over bags: runs ``trackslip_estimation.setup_check`` on a bag, and formats its result."""
