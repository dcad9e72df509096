"""That something ends. How fast it is, is for `benchmarks`: the machine that tests run on may be slow or busy."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

LONGEST_S = 30.0
"""CPU time of what takes seconds at most where its bounds hold, and minutes where they do not."""


@contextmanager
def ends() -> Iterator[None]:
    """What is inside may not take longer than `LONGEST_S` of CPU time."""
    began_s = time.process_time()
    yield
    took_s = time.process_time() - began_s
    assert took_s < LONGEST_S, f"took {took_s:.1f} s"
