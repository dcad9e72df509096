"""Printing what comes from recordings: nothing in it steers the terminal, and a closed pipe harms nothing."""

from __future__ import annotations

import contextlib
import errno
import os
import sys

from mapfusion_io.read_errors import printable

LONGEST_LINE = 2_000
"""Characters; a recording's names may be longer."""


def one_line(text: str) -> str:
    """The text as one line without anything that steers a terminal, of bounded length."""
    line = printable(text)
    return line if len(line) <= LONGEST_LINE else line[: LONGEST_LINE - 3] + "..."


def two_lines(text: str) -> str:
    """An error's text: what is wrong, and in a second line what to do."""
    what, _, do = text.partition("\n")
    return f"{one_line(what)}\n{one_line(do)}" if do else one_line(what)


def show(text: str) -> None:
    """Prints a result on stdout. That nobody reads it does not make the run a failure: the output is written by then.

    Characters that the terminal does not have are written as escapes.
    """
    if sys.stdout is None:  # closed before the start
        return
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    try:
        # not through typer.echo, which keeps every stream that it ever wrote to
        sys.stdout.write(text.encode(encoding, "backslashreplace").decode(encoding) + "\n")
        sys.stdout.flush()
    except OSError as error:
        silence_stdout()
        if error.errno != errno.EPIPE:
            complain(f"mapfusion: the result cannot be printed: {error.strerror or error}")


def complain(text: str) -> None:
    """Prints an error on stderr, where there is one and it takes it."""
    with contextlib.suppress(OSError):
        if sys.stderr is not None:
            sys.stderr.write(text + "\n")
            sys.stderr.flush()


def silence_stdout() -> None:
    """Keeps the interpreter from failing once more when it flushes stdout at its end."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)
