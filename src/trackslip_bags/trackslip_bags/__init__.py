# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Bags without ROS: written as rosbag2 MCAP, read in every form rosbag2 has, made from CSV logs."""
