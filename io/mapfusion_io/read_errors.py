"""The words for recordings that cannot be read."""

from __future__ import annotations

from pathlib import Path

from mapfusion.errors import LogReadError


def read_error(path: Path, what: str, do: str = "") -> LogReadError:
    """An error in two lines: which file and what is wrong with it, then what to do."""
    text = f"{shown(path)}: {printable(what)}"
    return LogReadError(f"{text}\n{printable(do)}" if do else text)


def os_error(path: Path, error: OSError) -> LogReadError:
    """The operating system refuses to give the file."""
    return read_error(path, f"cannot be read ({error.strerror or error})", "Check the path and its permissions.")


def shown(path: Path) -> str:
    """A path for the user."""
    return printable(str(path))


def printable(text: str) -> str:
    """The text in one line, with what would steer a terminal written as an escape."""
    return "".join(
        char if char.isprintable() else char.encode("unicode_escape", "backslashreplace").decode() for char in text
    )


def words(error: BaseException) -> str:
    """What a library said, in one line of bounded length."""
    text = printable(f"{type(error).__name__}: {error}" if str(error) else type(error).__name__)
    return text if len(text) <= 200 else text[:197] + "..."
