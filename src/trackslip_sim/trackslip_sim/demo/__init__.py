# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``make demo``: runs the whole graph on one computer: drive, recording, replay and scores."""
