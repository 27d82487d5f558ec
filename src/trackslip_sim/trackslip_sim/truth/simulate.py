# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Entry point of the truth: computes the true motion of a scenario, whole or in pieces.

Mode   shear      shear displacement along the contact (the truth of the evaluations)
       thesis     the thesis' own forward simulation, §6.2.1
"""

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Protocol

from trackslip_common.arrays import FloatArray
from trackslip_common.errors import InputError, suggestion
from trackslip_common.soils import load_soils
from trackslip_common.vehicle import UpperStructure, Vehicle
from trackslip_common.vehicle_files import load_vehicle
from trackslip_sim.scenarios.scenario import Scenario
from trackslip_sim.truth.ground import Ground, build_ground
from trackslip_sim.truth.mass_properties import MassProperties
from trackslip_sim.truth.record import Truth, join_pieces
from trackslip_sim.truth.rows import Recorder
from trackslip_sim.truth.settings import TruthSettings, load_settings
from trackslip_sim.truth.shear import ShearDrive
from trackslip_sim.truth.swing import Swing
from trackslip_sim.truth.thesis import ThesisDrive

PIECE = 60.0  # s


class Mode(Protocol):
    """A machine that starts at rest at the origin and is driven piece by piece."""

    relief_pressure: float  # Pa

    def __init__(
        self, ground: Ground, vehicle: Vehicle, settings: TruthSettings, relief_pressure: float
    ) -> None:
        """Raise ``InputError`` where vehicle, soils and settings are incompatible."""

    def first_row(self) -> FloatArray:
        """The row (1, WIDTH) at the start."""

    def drive(self, commands: FloatArray, mass_properties: FloatArray | None = None) -> FloatArray:
        """Rows (n // steps_per_sample, WIDTH) under further commands (n, 2), rad/s.

        ``mass_properties`` (n, 4): weight, N, and centre of gravity, m, of the machine; None: unchanged.
        """


MODES: Mapping[str, type[Mode]] = MappingProxyType({"shear": ShearDrive, "thesis": ThesisDrive})


def simulate(
    scenario: Scenario,
    *,
    soil: str | None = None,
    mode: str = "shear",
    vehicle: Vehicle | None = None,
    settings: TruthSettings | None = None,
    upper: UpperStructure | None = None,
) -> Truth:
    """The true motion of ``scenario`` from rest at the origin; deterministic.

    ``soil`` replaces the scenario's own; its patches stay. ``vehicle`` and ``settings`` default to
    ``config/vehicles/pc05.yaml`` and ``config/truth.yaml``; ``upper`` is needed by scenarios that swing.

    Raises:
        InputError: mode or soil is unknown, a soil lacks a value, or the load leaves the contact.
    """
    pieces = simulate_in_pieces(
        scenario, soil=soil, mode=mode, vehicle=vehicle, settings=settings, upper=upper
    )
    return join_pieces(list(pieces))


def simulate_in_pieces(
    scenario: Scenario,
    *,
    soil: str | None = None,
    mode: str = "shear",
    vehicle: Vehicle | None = None,
    settings: TruthSettings | None = None,
    upper: UpperStructure | None = None,
) -> Iterator[Truth]:
    """``simulate`` in consecutive pieces of at most ``PIECE`` s: memory does not grow with the drive.

    Raises:
        InputError: as ``simulate``, before the first piece is computed.
    """
    if mode not in MODES:
        raise InputError(f"mode: '{mode}' is unknown; accepted: {', '.join(MODES)}")
    soils = load_soils()
    name = soil if soil is not None else scenario.soil
    if name not in soils:
        raise InputError(f"soil: '{name}' is unknown{suggestion(name, soils)}")
    ground = build_ground(soils[name], scenario.patches, soils, scenario.terrain)
    vehicle, settings = vehicle or load_vehicle().whole(), settings or load_settings()
    relief = scenario.relief_pressure or vehicle.relief_pressure
    machine = MODES[mode](ground, vehicle, settings, relief)
    recorder = Recorder(vehicle, settings, machine.relief_pressure, ground.names)
    swing = Swing(scenario, upper, settings)
    mass_properties = MassProperties(scenario, vehicle, upper, settings)
    return _simulate_pieces(machine, recorder, swing, mass_properties)


def _simulate_pieces(
    machine: Mode, recorder: Recorder, swing: Swing, mass_properties: MassProperties
) -> Iterator[Truth]:
    settings, scenario = recorder.settings, mass_properties.scenario
    steps_per_sample = settings.steps_per_sample
    steps = scenario.steps(settings.step)
    piece_steps = max(1, round(PIECE / settings.sample_period)) * steps_per_sample
    done = 1
    start = recorder.truth(machine.first_row())
    for begin in range(0, steps, piece_steps):
        end = min(begin + piece_steps, steps)
        swung = swing.drive(begin, end)
        rows = machine.drive(
            scenario.commands(settings.step, begin, end), mass_properties.rows(swung[:, 0], begin, end)
        )
        truth = recorder.truth(rows, done, swung[steps_per_sample - 1 :: steps_per_sample])
        yield join_pieces([start, truth]) if begin == 0 else truth
        done += len(rows)


def duration_of(scenario: Scenario, settings: TruthSettings) -> float:
    """Time of the last sample of a simulated scenario, s."""
    return scenario.steps(settings.step) // settings.steps_per_sample * settings.sample_period
