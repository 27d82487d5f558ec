# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The setup check over bags: ``trackslip_estimation.setup_check`` with what a bag holds, and its text."""
