# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Declarations of records become dtypes."""

from typing import Annotated, ClassVar

import numpy as np
import pytest

from trackslip_common.record_types import FloatArray, IntArray, Record, Table, dtype_of, make_table


class Part(Record):
    """Of another."""

    number: int
    is_sound: bool


class Whole(Record):
    """With all kinds of fields."""

    KIND: ClassVar[str] = "no field"
    value: float
    mean: Annotated[FloatArray, 3]
    covariance: Annotated[FloatArray, (3, 3)]
    counts: Annotated[IntArray, 2]
    part: Part
    parts: Annotated[Table[Part], 4]


class More(Whole):
    """One with fields of its own behind."""

    last: int


def test_a_declaration_has_the_dtype_of_its_fields_in_their_order() -> None:
    part = np.dtype([("number", np.int64), ("is_sound", np.bool_)], align=True)
    fields = [
        ("value", np.float64),
        ("mean", np.float64, (3,)),
        ("covariance", np.float64, (3, 3)),
        ("counts", np.int64, (2,)),
        ("part", part),
        ("parts", part, (4,)),
    ]
    assert dtype_of(Whole) == np.dtype(fields, align=True)
    assert dtype_of(More) == np.dtype([*fields, ("last", np.int64)], align=True)


def test_what_is_no_number_array_record_or_table_is_refused() -> None:
    class Wrong(Record):
        name: str

    with pytest.raises(TypeError, match="name"):
        dtype_of(Wrong)


def test_a_table_is_an_array_of_records() -> None:
    table = make_table(Part, dtype_of(Part), 2, 3)
    assert table.shape == (2, 3)
    table[1, 2]["number"] = 7
    assert table["number"].tolist() == [[0, 0, 0], [0, 0, 7]]
