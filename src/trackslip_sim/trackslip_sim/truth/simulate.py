# SPDX-License-Identifier: Apache-2.0
"""The single entry to the truth: a scenario in, the true motion out.

Mode   shear      shear displacement along the contact (the truth of the evaluations)
       thesis     the thesis' own forward simulation, §6.2.1
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from trackslip_common.errors import InputError
from trackslip_common.soils import load_soils
from trackslip_common.vehicle import Vehicle
from trackslip_sim.scenarios.scenario import Scenario
from trackslip_sim.truth import shear, thesis
from trackslip_sim.truth.ground import Ground, build_ground
from trackslip_sim.truth.record import Truth
from trackslip_sim.truth.settings import TruthSettings, load_settings, load_vehicle

Mode = Callable[[Scenario, Ground, Vehicle, TruthSettings], Truth]
MODES: Mapping[str, Mode] = MappingProxyType({"shear": shear.simulate, "thesis": thesis.simulate})


def simulate(
    scenario: Scenario,
    *,
    soil: str | None = None,
    mode: str = "shear",
    vehicle: Vehicle | None = None,
    settings: TruthSettings | None = None,
) -> Truth:
    """Drive ``scenario`` from rest at the origin; deterministic.

    ``soil`` replaces the scenario's own; its patches stay. ``vehicle`` and ``settings`` default to
    ``config/pc05.yaml`` and ``config/truth.yaml``.

    Raises:
        InputError: mode or soil is unknown, a soil lacks a value, or the load leaves the contact.
    """
    if mode not in MODES:
        raise InputError(f"mode: '{mode}' is unknown; accepted: {', '.join(MODES)}")
    soils = load_soils()
    name = soil if soil is not None else scenario.soil
    if name not in soils:
        raise InputError(f"soil: '{name}' is unknown; accepted: {', '.join(soils)}")
    ground = build_ground(soils[name], scenario.patches, soils)
    return MODES[mode](scenario, ground, vehicle or load_vehicle(), settings or load_settings())
