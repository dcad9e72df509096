"""Signals that ask a run to end unwind the stack, so that no half-written file is left."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import CodeType, FrameType

AGAIN_AFTER_S = 0.01
"""Between two signals that stand for one whose exception was forgotten: by then the function that forgot it has
returned, or forgets the next one as well."""


class _Terminated(SystemExit):
    """Raised where a signal finds the program."""

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
        KeyboardInterrupt: Ctrl-C.
    """
    heeded_again: list[threading.Event] = []

    def send_again(signum: int) -> None:
        if all(heeded.is_set() for heeded in heeded_again):  # one at a time: a second would interrupt the unwinding
            heeded_again.append(threading.Event())
            threading.Thread(target=_send_until, args=(heeded_again[-1], signum), daemon=True).start()

    def unwind(signum: int, frame: FrameType | None) -> None:
        if _is_within(frame, on_forgotten.__code__):  # whatever is raised there is forgotten too
            send_again(signum)
            return
        for heeded in heeded_again:
            heeded.set()
        raise KeyboardInterrupt if signum == signal.SIGINT else _Terminated(signum)

    def on_forgotten(lost: sys.UnraisableHookArgs) -> None:
        if isinstance(lost.exc_value, _Terminated):
            send_again(lost.exc_value.signum)
        elif isinstance(lost.exc_value, KeyboardInterrupt):
            send_again(signal.SIGINT)
        else:
            hook_before(lost)

    names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]  # Windows has no SIGHUP
    numbers = [getattr(signal, name) for name in names]
    not_ignored = [number for number in numbers if signal.getsignal(number) not in (signal.SIG_IGN, None)]
    before: dict[int, Callable[[int, FrameType | None], object] | int | None] = {}
    hook_before = sys.unraisablehook
    try:
        sys.unraisablehook = on_forgotten
        for number in not_ignored:
            before[number] = signal.getsignal(number)
            signal.signal(number, unwind)
        yield
    except SystemError as error:  # compiled code that the signal found as it was called or returned
        asked = _asked_by(error)
        if asked is None:
            raise
        raise asked from None
    finally:
        for heeded in heeded_again:
            heeded.set()
        for number, handler in before.items():
            signal.signal(number, handler)
        sys.unraisablehook = hook_before


def _asked_by(error: BaseException | None) -> BaseException | None:
    """What a signal raised, where an error came of it."""
    while error is not None and not isinstance(error, (_Terminated, KeyboardInterrupt)):
        error = error.__cause__ or error.__context__
    return error


def _is_within(frame: FrameType | None, code: CodeType) -> bool:
    """Whether the frame is one of `code`, or was called from one."""
    while frame is not None and frame.f_code is not code:
        frame = frame.f_back
    return frame is not None


def _send_until(heeded: threading.Event, signum: int) -> None:
    """Sends to the main thread, which wakes it where it waits, again and again."""
    while not heeded.wait(AGAIN_AFTER_S):
        if hasattr(signal, "pthread_kill"):
            signal.pthread_kill(threading.main_thread().ident or 0, signum)
        else:
            signal.raise_signal(signum)
