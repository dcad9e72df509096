"""A signal that asks a run to end does end it."""

import os
import signal
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator

import pytest

from mapfusion_cli.signals import AGAIN_AFTER_S, unwinding

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
LONG_S = 20.0


@pytest.fixture(autouse=True)
def _heeded() -> Iterator[None]:
    """No signal is ignored, whatever the tests were started by."""
    before = {signum: signal.signal(signum, signal.SIG_DFL) for signum in (signal.SIGTERM, signal.SIGHUP)}
    before[signal.SIGINT] = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    for signum, handler in before.items():
        signal.signal(signum, handler)


class _Dying:
    """Something that a weak reference can point at."""


def _run(signalled: Callable[[], object]) -> None:
    """A run that is signalled at once and would last long, in one wait."""
    with unwinding():
        signalled()
        time.sleep(LONG_S)


def _amid_a_callback(signalled: Callable[[], object]) -> Callable[[], object]:
    """Calls in the callback of a weak reference, whose exceptions are forgotten."""
    dying = [_Dying()]
    kept = weakref.ref(dying[0], lambda _: signalled())

    def die() -> None:
        dying.clear()
        assert kept() is None

    return die


def _both(first: int, second: int) -> None:
    """Both signals are pending when the first of them is handled."""
    signal.pthread_sigmask(signal.SIG_BLOCK, [first, second])
    for signum in (first, second):
        signal.pthread_kill(threading.get_ident(), signum)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [first, second])


@pytest.mark.parametrize("signum", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_run_with_its_code_and_the_handlers_are_as_before(signum: signal.Signals) -> None:
    before, hook = signal.getsignal(signum), sys.unraisablehook
    with pytest.raises(SystemExit) as ended:
        _run(lambda: signal.raise_signal(signum))
    assert ended.value.code == 128 + signum
    assert (signal.getsignal(signum), sys.unraisablehook) == (before, hook)


@pytest.mark.parametrize(
    ("signum", "expected"),
    [(signal.SIGTERM, SystemExit), (signal.SIGHUP, SystemExit), (signal.SIGINT, KeyboardInterrupt)],
)
def test_a_signal_amid_a_function_whose_exceptions_are_forgotten_still_ends_the_run(
    signum: signal.Signals, expected: type[BaseException], capfd: pytest.CaptureFixture[str]
) -> None:
    began_s = time.monotonic()
    with pytest.raises(expected):
        _run(_amid_a_callback(lambda: signal.raise_signal(signum)))
    assert time.monotonic() - began_s < LONG_S / 2
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(("first", "second"), [(signal.SIGTERM, signal.SIGHUP), (signal.SIGINT, signal.SIGTERM)])
def test_two_signals_at_once_amid_such_a_function_end_the_run(
    first: int, second: int, capfd: pytest.CaptureFixture[str]
) -> None:
    began_s = time.monotonic()
    with pytest.raises((SystemExit, KeyboardInterrupt)):
        _run(_amid_a_callback(lambda: _both(first, second)))
    assert time.monotonic() - began_s < LONG_S / 2
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("signum", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_as_compiled_code_returns_ends_the_run(signum: signal.Signals) -> None:
    def returned() -> None:
        try:
            signal.raise_signal(signum)
        except BaseException as found:
            try:
                raise SystemError("a compiled function returned a result with an exception set") from found
            except SystemError:
                raise SystemError("one around it as well")  # noqa: B904

    with pytest.raises(SystemExit if signum == signal.SIGTERM else KeyboardInterrupt):
        _run(returned)
    with pytest.raises(SystemError, match="of its own"), unwinding():
        raise SystemError("of its own")


def test_a_signal_that_is_forgotten_as_the_run_ends_hits_nothing_after_it() -> None:
    with unwinding():
        _amid_a_callback(lambda: signal.raise_signal(signal.SIGINT))()
    time.sleep(10 * AGAIN_AFTER_S)


def test_an_ignored_signal_stays_ignored() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with unwinding():
        signal.raise_signal(signal.SIGHUP)
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN


def test_other_forgotten_exceptions_are_told_as_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    monkeypatch.setattr(sys, "unraisablehook", lambda lost: told.append(str(lost.exc_value)))

    def forgotten() -> None:
        raise ValueError("forgotten")

    with unwinding():
        _amid_a_callback(forgotten)()
    assert told == ["forgotten"]
