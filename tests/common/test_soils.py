# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Soils: the tables as printed, and rejected values."""

import math
from pathlib import Path

import pytest

from trackslip_common.errors import InputError
from trackslip_common.soils import RANGES, Soil, load_soils, soil

TABLE_6_1 = {  # c kPa, ϕ deg, K cm, μ_r, μ_l, n, k_c kN, k_ϕ kN
    "sand": (1.04, 28.0, 1.0, 0.2, 1.15, 1.1, 0.95, 1528.43),
    "sandy_loam": (1.72, 29.0, 2.5, 0.2, 1.3, 0.7, 5.27, 1515.04),
    "clayey_soil": (4.14, 13.0, 0.6, 0.3, 0.6, 0.5, 13.19, 692.15),
    "dry_clay": (0.0, 34.0, 0.6, 0.1, 0.8, 0.13, 12.70, 1555.95),
}
TABLE_2_1 = {  # c kPa, ϕ deg, K cm; the same between rubber and soil
    "medium_soil": (8.62, 22.5, 2.54, 4.64, 19.9, 2.12),
    "clayey_soil_chapter_2": (7.58, 14.0, 2.54, 4.08, 12.4, 2.12),
    "soft_soil": (3.71, 25.6, 2.1, None, None, None),
    "lete_sand": (1.3, 31.1, 1.2, 0.7, 27.5, 1.0),
    "petawawa_snow": (0.4, 24.0, None, 0.12, 16.4, 0.4),
    "petawawa_muskeg": (2.8, 39.4, 3.1, None, None, None),
}
TABLE_2_2 = {  # n, k_c kN, k_ϕ kN, k_0 kPa/m, A_u kPa/m²
    "medium_soil": (0.8, 29.76, 2083.0, 0.0, 192400.0),
    "clayey_soil_chapter_2": (0.6, 38.08, 499.7, 0.0, 63106.0),
    "soft_soil": (0.8, 16.54, 911.4, 0.0, 86000.0),
}


def scaled(values, factors):
    return [
        None if v is None else pytest.approx(v * f, rel=1e-12) for v, f in zip(values, factors, strict=True)
    ]


def test_tables_are_as_printed():
    for name, row in TABLE_6_1.items():
        s = soil(name)
        values = [s.cohesion, s.friction_angle, s.shear_modulus, s.mu_r, s.mu_l, s.n, s.k_c, s.k_phi]
        assert values == scaled(row, (1e3, math.pi / 180, 0.01, 1, 1, 1, 1e3, 1e3)), name
    for name, shear in TABLE_2_1.items():
        s = soil(name)
        values = [s.cohesion, s.friction_angle, s.shear_modulus]
        values += [s.rubber_cohesion, s.rubber_friction_angle, s.rubber_shear_modulus]
        assert values == scaled(shear, (1e3, math.pi / 180, 0.01) * 2), name
    for name, sinkage in TABLE_2_2.items():
        s = soil(name)
        assert [s.n, s.k_c, s.k_phi, s.k_0, s.a_u] == scaled(sinkage, (1, 1e3, 1e3, 1e3, 1e3)), name


def test_no_soil_beyond_the_tables():
    assert set(load_soils()) == set(TABLE_6_1) | set(TABLE_2_1)
    assert all(s.name == name and "Table" in s.source for name, s in load_soils().items())


def test_unknown_soil_lists_the_known_ones():
    with pytest.raises(
        InputError, match="'mud' is unknown; accepted: sand, sandy_loam, clayey_soil, dry_clay"
    ):
        soil("mud")


@pytest.mark.parametrize("field", RANGES)
def test_every_field_refuses_the_impossible(field):
    for bad in (-1.0, math.nan, math.inf, "5", True, *([math.pi / 2] if "angle" in field else [])):
        with pytest.raises(InputError) as refused:
            Soil(name="x", **{"cohesion": 1000.0, "friction_angle": 0.5} | {field: bad})
        accepted = RANGES[field].accepted_range()
        assert str(refused.value) == f"soil 'x': {field} = {bad!r} is refused; accepted: {accepted}"


def test_soil_without_strength_is_refused():
    with pytest.raises(InputError, match="cohesion = friction_angle = 0"):
        Soil(name="x", cohesion=0.0, friction_angle=0.0)


def test_value_missing_in_the_table_is_refused():
    assert soil("sand").value("shear_modulus") == 0.01
    with pytest.raises(InputError, match=r"'petawawa_snow': shear_modulus = None.*accepted: > 0"):
        soil("petawawa_snow").value("shear_modulus")
    with pytest.raises(InputError, match="no property 'colour'; accepted: cohesion"):
        soil("sand").value("colour")


def test_own_file_in_si_units(tmp_path: Path):
    file = tmp_path / "own.yaml"
    file.write_text("loess: {cohesion: 2500, friction_angle: 0.5, shear_modulus: 0.02}")
    assert load_soils(str(file)) == {
        "loess": Soil(name="loess", cohesion=2500.0, friction_angle=0.5, shear_modulus=0.02)
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "a: {cohesion: 1, friction_angle_deg: 90}",
            r"friction_angle_deg = 90 is refused; accepted: friction_",
        ),
        ("a: {cohesion: 1, friction_angle: 0.5, shear_modulus_cm: -1}", r"shear_modulus_cm = -1 is refused"),
        (
            "a: {cohesion: 1, friction_angle: 0.5, mu_r: much}",
            r"mu_r = 'much' is refused; accepted: mu_r >= 0",
        ),
        ("a: {cohesion: 1, friction_angle: 0.5, mu_r: true}", r"mu_r = True is refused"),
        ("a: {cohesion: 1}", r"friction_angle is missing; accepted: >= 0 and < 1.5708 rad"),
        ("a: {cohesion: 1, cohesion_kPa: 1}", r"cohesion is given twice"),
        ("a: {cohesion_cm: 1}", r"unknown property 'cohesion_cm'; accepted: cohesion, friction_angle"),
        ("a: {name: b}", r"unknown property 'name'"),
        ("a: 3", r"soil 'a': 3 is not a mapping"),
        ("{}", r"no soils in it"),
        ("- a", r"expected names and values"),
    ],
)
def test_bad_file_is_refused_in_one_line(tmp_path: Path, text, message):
    file = tmp_path / "own.yaml"
    file.write_text(text)
    with pytest.raises(InputError, match=message) as refused:
        load_soils(str(file))
    assert str(file) in str(refused.value)
    assert "\n" not in str(refused.value)
