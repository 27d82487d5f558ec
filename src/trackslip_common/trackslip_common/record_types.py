# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Records for compiled code, each declared once: as a class that types and dtypes are derived from.

    class Level(Record):
        known: int
        downhill: Annotated[FloatArray, 2]
        sample: Sample
        faults: Annotated[Table[Fault], 12]

    LEVEL = dtype_of(Level)

A kernel that takes a ``Level`` is annotated with the class, so that an editor finds the declaration of each
field. At run time it gets a record of an array of ``LEVEL``. Python reads the same array by the names of its
fields.
"""

from types import UnionType
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    Generic,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
    overload,
)

import numpy as np
from numpy.typing import NDArray

from trackslip_common.arrays import FloatArray, IntArray
from trackslip_common.parameters import Parameters

RecordT = TypeVar("RecordT")
DeclaredT = TypeVar("DeclaredT", bound="Record | Parameters")

_NUMBERS: dict[object, type[np.generic]] = {float: np.float64, int: np.int64, bool: np.bool_}
_ARRAYS: dict[object, type[np.generic]] = {FloatArray: np.float64, IntArray: np.int64}


class Record:
    """Base of declarations; it is never instantiated."""

    if TYPE_CHECKING:  # Python reads and writes fields by name

        def __getitem__(self, name: str) -> Any: ...

        def __setitem__(self, name: str, value: Any) -> None: ...


if TYPE_CHECKING:
    Index = int | np.integer[Any]

    class Table(np.ndarray[Any, np.dtype[np.void]], Generic[RecordT]):
        """An array of records, of one or more dimensions."""

        @overload  # type: ignore[override]
        def __getitem__(self, at: Index | tuple[Index, ...]) -> RecordT: ...

        @overload
        def __getitem__(self, at: str) -> NDArray[Any]: ...

        @overload
        def __getitem__(self, at: Any) -> "Table[RecordT]": ...

        def __getitem__(self, at: Any) -> Any: ...

else:

    class Table(Generic[RecordT]):
        """An array of records, of one or more dimensions."""


def dtype_of(declared: type[DeclaredT]) -> np.dtype[np.void]:
    """The aligned dtype of a declaration, or of a group of numeric parameters, in the order of its fields.

    Optional groups are left out.

    Raises:
        TypeError: a field is neither a number, nor an array of numbers, nor a record, nor a table of records.
    """
    hints = get_type_hints(declared, include_extras=True)
    fields = [
        _field(name, hint)
        for name, hint in hints.items()
        if get_origin(hint) is not ClassVar and not isinstance(hint, UnionType)
    ]
    return np.dtype(fields, align=True)


def _field(name: str, hint: Any) -> tuple[Any, ...]:
    """A field in the form of ``np.dtype``."""
    shape: Any = ()
    if hasattr(hint, "__metadata__"):
        (shape,) = hint.__metadata__
        hint = get_args(hint)[0]
    if get_origin(hint) is Table:
        (hint,) = get_args(hint)
    if hint in _NUMBERS:
        kind: Any = _NUMBERS[hint]
    elif hint in _ARRAYS:
        kind = _ARRAYS[hint]
    elif isinstance(hint, type) and issubclass(hint, Record | Parameters):
        kind = dtype_of(hint)
    else:
        raise TypeError(f"{name}: {hint} is no number, array, record or table")
    return (name, kind, shape) if shape != () else (name, kind)


def make_table(declared: type[RecordT], dtype: np.dtype[np.void], *shape: int) -> "Table[RecordT]":
    """An array of zero records; ``dtype``: that of ``declared``."""
    return cast("Table[RecordT]", np.zeros(shape, dtype))
