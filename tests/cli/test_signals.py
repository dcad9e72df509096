"""A signal that asks a run to end is never lost."""

import os
import signal
import sys
import time
import weakref
from collections.abc import Callable

import pytest

from mapfusion_cli.signals import unwinding

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")


class _Dying:
    """Something that a weak reference can point at."""


def _run(signalled: Callable[[], object]) -> None:
    """A run that is signalled at once and would last long."""
    with unwinding():
        signalled()
        until_s = time.monotonic() + 10.0
        while time.monotonic() < until_s:
            time.sleep(0.01)


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
    came: list[str] = []

    def forgotten(_: object) -> None:
        came.append("here")
        signal.raise_signal(signum)
        came.append("never")

    dying = [_Dying()]
    reference = weakref.ref(dying[0], forgotten)
    with pytest.raises(expected):
        _run(dying.clear)
    assert (came, reference()) == (["here"], None)
    assert capfd.readouterr().err == ""


def test_other_forgotten_exceptions_are_told_as_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[BaseException | None] = []
    monkeypatch.setattr(sys, "unraisablehook", lambda lost: told.append(lost.exc_value))

    def forgotten(_: object) -> None:
        raise ValueError("forgotten")

    dying = _Dying()
    reference = weakref.ref(dying, forgotten)
    with unwinding():
        del dying
    assert reference() is None
    assert [str(error) for error in told] == ["forgotten"]
