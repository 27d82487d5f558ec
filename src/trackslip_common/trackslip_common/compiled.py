# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Decorators that compile functions: machine code is kept on disk, and runs without the interpreter's lock.

``compiled`` is for kernels and for functions that several of them call. Each such function is optimised
together with all that it calls, so a chain of them is optimised repeatedly. ``inlined`` is for parts of a
longer function, which have one caller: they become part of it.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar, cast

os.environ.setdefault("NUMBA_OPT", "1")  # compiles in 60 % of the time, to code that is as fast here

import llvmlite.binding
import numba
from numba.core.types import unliteral

from trackslip_common.machine_code import KernelCache

# Loops have a dozen elements; unrolled for any number of passes they are a third of all code, not faster.
llvmlite.binding.set_option("trackslip", "--unroll-runtime=false")

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile at the first call and keep the result (strict IEEE arithmetic).

    Numba names the result by the file's path; colcon and ``make setup`` import the same file by two paths.
    """
    file = os.path.realpath(function.__code__.co_filename)
    function.__code__ = function.__code__.replace(co_filename=file)
    kernel = numba.njit(nogil=True, error_model="numpy", no_cfunc_wrapper=True)(function)
    if kernel is not function:  # compilation is not switched off
        kernel._cache = KernelCache(function)
        _compile_per_type(kernel)
    return cast(F, kernel)


def inlined(function: F) -> F:
    """Compile as part of the single function that calls it."""
    return cast(F, numba.njit(nogil=True, error_model="numpy", inline="always")(function))


def _compile_per_type(kernel: Any) -> None:
    """Compile once per argument type, not again for each constant that a caller passes."""
    template = kernel.get_call_template

    def template_of_types(args: Sequence[Any], names: Mapping[str, Any]) -> Any:
        return template(
            tuple(map(unliteral, args)), {name: unliteral(type_) for name, type_ in names.items()}
        )

    kernel.get_call_template = template_of_types
