from __future__ import annotations

from pathlib import Path

from mapfusion_io.read_errors import os_error, printable, read_error, words


def test_error_is_two_lines_whatever_the_name() -> None:
    text = str(read_error(Path("a\nb\x1b[2J.mcap"), "is\tbroken", "Do this."))
    assert text == "a\\nb\\x1b[2J.mcap: is\\tbroken\nDo this."


def test_printable_keeps_letters_and_escapes_what_steers_a_terminal() -> None:
    assert printable("Käfer/地図") == "Käfer/地図"
    assert printable("\u202e\udcff\0") == "\\u202e\\udcff\\x00"


def test_words_of_a_library_are_short() -> None:
    assert words(KeyError()) == "KeyError"
    assert words(ValueError("a\nb")) == "ValueError: a\\nb"
    assert len(words(ValueError("x" * 1000))) == 200


def test_what_the_operating_system_says() -> None:
    assert "Permission denied" in str(os_error(Path("a"), PermissionError(13, "Permission denied")))
