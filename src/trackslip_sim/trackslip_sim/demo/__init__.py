# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``make demo``: the whole graph on a laptop, driven, recorded, replayed and scored."""
