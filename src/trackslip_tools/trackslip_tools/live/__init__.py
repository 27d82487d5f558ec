# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The live page: shows the machine's motion from the graph or a bag, on a phone, a tablet or a desktop."""
