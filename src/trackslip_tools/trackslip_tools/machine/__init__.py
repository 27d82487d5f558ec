# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Files of a new machine: its vehicle file, and initial uncertainties for guessed numbers."""
