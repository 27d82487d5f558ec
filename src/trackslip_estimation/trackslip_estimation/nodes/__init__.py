# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""ROS nodes: thin wrappers of the estimators."""
