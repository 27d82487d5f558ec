# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Files of a new machine: its vehicle, and what the estimator has to expect of numbers that were guessed."""
