"""Signals that ask a run to end unwind the stack, so that no half-written file is left."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType

AGAIN_AFTER_S = 0.01
"""Before a signal is sent again whose exception was lost; the function that lost it has returned by then."""


class _Terminated(SystemExit):
    """Raised where the signal finds the program."""

    def __init__(self, signum: int) -> None:
        super().__init__(128 + signum)
        self.signum = signum


@contextlib.contextmanager
def unwinding() -> Iterator[None]:
    """SIGTERM, and SIGHUP where it is not ignored, unwind the stack as Ctrl-C does.

    A signal may find the program in a function whose exceptions Python prints and forgets: a finalizer, or the callback
    of a weak reference as every import has them. It is sent again then, rather than lost with the run going on.

    Raises:
        SystemExit: A signal came; 128 and its number is the exit code.
    """

    def terminate(signum: int, frame: FrameType | None) -> None:
        raise _Terminated(signum)

    def send_again(lost: sys.UnraisableHookArgs) -> None:
        if isinstance(lost.exc_value, _Terminated):
            _send_later(lost.exc_value.signum)
        elif isinstance(lost.exc_value, KeyboardInterrupt):
            _send_later(signal.SIGINT)
        else:
            hook_before(lost)

    names = [name for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]  # Windows has no SIGHUP
    before = {getattr(signal, name): signal.getsignal(getattr(signal, name)) for name in names}
    hook_before = sys.unraisablehook
    sys.unraisablehook = send_again
    for signum, handler in before.items():
        if handler not in (signal.SIG_IGN, None):
            signal.signal(signum, terminate)
    try:
        yield
    finally:
        for signum, handler in before.items():
            signal.signal(signum, handler or signal.SIG_DFL)
        sys.unraisablehook = hook_before


def _send_later(signum: int) -> None:
    """To this process, which wakes the main thread where it waits; Windows' own `kill` would end it at once."""
    send = signal.raise_signal if os.name == "nt" else lambda number: os.kill(os.getpid(), number)
    timer = threading.Timer(AGAIN_AFTER_S, send, [signum])
    timer.daemon = True
    timer.start()
