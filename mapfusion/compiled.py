"""Inner loops, compiled to machine code when they are first called.

What numpy would do in dozens of passes over small arrays takes one here. The code is kept beside the module, or in the
user's cache folder, so that only the first process on a machine compiles; where there is no such place, each does.
Kept code follows changes of its own file only: a compiled function may call functions and read names of its own module
and of numpy and math, nothing else, and constants that it reads must not be made of others' either. Whoever changes how
functions are compiled, below, deletes what is kept.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """The function as machine code; divisions by zero give infinity or NaN, as in numpy.

    Arguments are numbers, and arrays that are contiguous in memory: for each other combination of types it is compiled
    again. Sums keep their order, so the result is the same on every call.
    """
    try:
        machine_code = numba.njit(function, cache=True, error_model="numpy", nogil=True)
    except RuntimeError:  # there is no place to keep it
        machine_code = numba.njit(function, error_model="numpy", nogil=True)
    return cast("Callable[P, R]", machine_code)
