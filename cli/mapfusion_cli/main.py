"""The command `mapfusion`: its verbs, and the one place where errors become words and exit codes."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Sequence
from functools import cache
from typing import Annotated, NoReturn

import typer
from typer.main import get_command

from mapfusion.errors import ConfigError, MapfusionError
from mapfusion.version import __version__
from mapfusion_cli.evaluate import evaluate
from mapfusion_cli.info import info
from mapfusion_cli.replay import replay
from mapfusion_cli.signals import unwinding
from mapfusion_cli.simulate import simulate

FAILED, USAGE = 1, 2
"""Exit codes; 0 is done and 3 is done with losses."""
DEBUG_VARIABLE = "MAPFUSION_DEBUG"
"""Set in the environment, an error of the program itself shows its traceback."""

_USAGE_ERRORS: tuple[type[BaseException], ...] = typer.BadParameter.__bases__
"""The library's errors about arguments, whose common class it does not export."""

app = typer.Typer(
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Fuses the recorded occupancy grids of several robots into one map, and says how far to trust it.",
)
app.command()(replay)
app.command()(info)
app.command()(simulate)
app.command()(evaluate)


def _print_version(wanted: bool) -> None:
    if wanted:
        from mapfusion_cli.printing import show

        show(f"mapfusion {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


@cache
def _command() -> Callable[..., int | None]:
    """The command put together, which takes longer than reading a small recording: once a process."""
    return get_command(app)


def run(arguments: Sequence[str] | None = None) -> None:
    """Entry point of the command; always ends in SystemExit.

    Args:
        arguments: Instead of the process's own.
    """
    try:
        with unwinding():
            command = _command()
            code = command(
                args=None if arguments is None else list(arguments), prog_name="mapfusion", standalone_mode=False
            )
    except _USAGE_ERRORS as error:
        _fail(_usage_words(error), USAGE)
    except ConfigError as error:
        _fail(str(error), USAGE)
    except MapfusionError as error:
        _fail(str(error), FAILED)
    except KeyboardInterrupt:  # while the library puts the command together; later it says the same itself
        raise SystemExit(128 + signal.SIGINT) from None
    except MemoryError:
        _fail("out of memory", FAILED)
    except OSError as error:  # the library prints the help, and nothing else leaves as one
        from mapfusion_cli.printing import silence_stdout

        silence_stdout()
        _fail(f"cannot be printed: {error.strerror or error}", FAILED)
    except Exception as error:
        if os.environ.get(DEBUG_VARIABLE):
            raise
        _fail(f"an error of mapfusion itself: {error!r}\nPlease report it, with what {DEBUG_VARIABLE}=1 shows.", FAILED)
    raise SystemExit(code or 0)


def _usage_words(error: BaseException) -> str:
    """What is wrong with the arguments, and where to look."""
    command = getattr(getattr(error, "ctx", None), "command_path", "mapfusion")
    words = error.format_message() if hasattr(error, "format_message") else str(error)
    return f"{' '.join(words.split())}\n`{command} --help` lists what there is."


def _fail(words: str, code: int) -> NoReturn:
    from mapfusion_cli.printing import complain, two_lines

    complain(two_lines(f"mapfusion: {words}"))
    raise SystemExit(code)
