# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""ROS nodes: the recorder, and the player of bags to a live graph."""
