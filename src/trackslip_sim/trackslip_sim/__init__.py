# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""An excavator to run without one: truth models, sensor models, and devices that talk real bytes."""
