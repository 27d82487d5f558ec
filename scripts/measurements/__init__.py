# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Measurements of the numbers in the documents: name of a block → function that returns its lines.

The functions take a working folder, and raise ``NotMeasured`` if a log is missing or a command fails. Long
ones come first, for a balanced load.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from measurements import attitude, cab, excavator, real_logs, recorded, studies

Measurement = Callable[[Path], Sequence[str]]

MEASUREMENTS: Mapping[str, Measurement] = MappingProxyType(
    {
        "soil_on_slopes": studies.soil_on_slopes,
        "dig_cycles": cab.dig_cycles,
        "turned_cab": cab.turned_cab,
        "dig_study": cab.dig_study,
        "attitude": attitude.on_slopes,
        "attitude_with_rtk": attitude.with_rtk,
        "drawn_machines": studies.drawn_machines,
        "two_machines": studies.two_machines,
        "real_logs": real_logs.with_geometry_alone,
        "wrong_numbers": excavator.wrong_numbers,
        "excavator_replay": excavator.printed,
        "recorded_runs": recorded.runs,
        "study_ranges": recorded.study_ranges,
        "slope_ranges": recorded.slope_ranges,
    }
)
CHEAP = ("recorded_runs", "study_ranges", "slope_ranges")
"""Of files in the tree; a test compares what the pages say with what these give."""
