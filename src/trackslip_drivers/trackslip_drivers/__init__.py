# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""From sensor bytes to messages: protocols, transports, nodes."""
