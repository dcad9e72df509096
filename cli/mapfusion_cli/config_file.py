"""Options of a verb from a TOML file, and back into one; their names are those of the options without the dashes."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Sequence
from enum import Enum
from pathlib import Path

import typer

from mapfusion.errors import ConfigError
from mapfusion_cli.printing import show

_NOT_IN_FILE = ("paths", "config", "print_config_")


def config_callback(ctx: typer.Context, path: Path | None) -> Path | None:
    """Makes the file's values the defaults of the command that is being parsed.

    Raises:
        ConfigError: The file cannot be read, is no TOML, or has an unknown option.
    """
    if path is None:
        return None
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"--config {path}: {error}") from error
    known = {
        _file_name(parameter.opts): parameter
        for parameter in ctx.command.params
        if parameter.name and parameter.name not in _NOT_IN_FILE
    }
    unknown = sorted(key for key in values if key.replace("_", "-") not in known)
    if unknown:
        raise ConfigError(f"--config {path}: unknown option {', '.join(unknown)}; known are {', '.join(sorted(known))}")
    ctx.default_map = {str(known[key.replace("_", "-")].name): value for key, value in values.items()}
    return path


def print_config(ctx: typer.Context) -> None:
    """Prints the options in effect as such a file."""
    values = options_in_effect(ctx, _NOT_IN_FILE)
    show("\n".join(f"{name} = {_toml(value)}" for name, value in values.items()))


def options_in_effect(ctx: typer.Context, left_out: tuple[str, ...]) -> dict[str, object]:
    """The options that are set, by the names they have in a file."""
    return {
        _file_name(parameter.opts): value.value if isinstance(value, Enum) else value
        for parameter in ctx.command.params
        if parameter.name not in left_out and not _is_unset(value := ctx.params.get(parameter.name or ""))
    }


def _is_unset(value: object) -> bool:
    return value is None or (isinstance(value, list | tuple) and not value)


def _file_name(names: Sequence[str]) -> str:
    """`mae-threshold` of `--mae-threshold`."""
    longest = max(names, key=len)
    return longest.lstrip("-") if longest.startswith("-") else ""


def _toml(value: object) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(_toml(item) for item in value)}]"
    # Strings, numbers and booleans are written alike in JSON and TOML.
    return json.dumps(str(value) if isinstance(value, Path) else value)
