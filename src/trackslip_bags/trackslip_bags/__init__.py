# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Bags without ROS: writes rosbag2 MCAP, reads all storage forms of rosbag2, converts CSV logs."""
