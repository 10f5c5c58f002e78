"""The commands together, and what they do about errors."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from imm_tdoa.cli.bench import bench
from imm_tdoa.cli.locate import locate
from imm_tdoa.cli.models import models
from imm_tdoa.cli.reproduce import app as reproduce
from imm_tdoa.cli.select import select
from imm_tdoa.cli.simulate import simulate
from imm_tdoa.cli.study import study
from imm_tdoa.cli.track import track

# What Typer raises for a wrong command line; its module differs between versions.
_UsageError: type[Exception] = next(
    c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException"
)

# How recent versions of Typer put it, and how our own messages do.
_WORDS = {
    "Value error, ": "",
    "Input should be a valid integer, unable to parse string as an integer": (
        "expected a whole number"
    ),
    "Input should be a valid number, unable to parse string as a number": "expected a number",
    "Input should be greater than or equal to": "expected at least",
}


class Commands(TyperGroup):
    """Commands whose errors are one line on stderr and exit code 2."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Run, and leave by SystemExit."""
        kwargs["standalone_mode"] = False
        try:
            code = super().main(*args, **kwargs)
        except _UsageError as error:
            _fail(_in_our_words(error.format_message()))  # type: ignore[attr-defined]
        except (KeyboardInterrupt, typer.Abort):
            sys.exit(130)
        except typer.Exit as error:
            sys.exit(error.exit_code)
        except OSError as error:
            place = "" if error.filename is None else f"{error.filename}: "
            _fail(f"{place}{error.strerror or error}")
        except ValueError as error:
            _fail(str(error))
        sys.exit(code if isinstance(code, int) else 0)


def _in_our_words(message: str) -> str:
    for theirs, ours in _WORDS.items():
        message = message.replace(theirs, ours)
    return message


def _fail(message: str) -> None:
    line = " ".join(message.split())
    print(f"imm-tdoa: error: {line}", file=sys.stderr)
    sys.exit(2)


app = typer.Typer(
    cls=Commands,
    add_completion=False,
    invoke_without_command=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        from imm_tdoa import __version__

        typer.echo(f"imm-tdoa {__version__}")
        raise typer.Exit


@app.callback()
def about(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    """Track emitters of unknown manoeuvre from time differences of arrival (TDOA).

    Start here; it runs on a recording that ships with the program:

        imm-tdoa track

    Then on yours, a folder with recording.toml, stations.csv and toa.csv or tdoa.csv:

        imm-tdoa track my-recording --bank vehicle --robust gate

    `imm-tdoa COMMAND --help` explains each command with an example.
    """
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


app.command()(track)
app.command()(locate)
app.command()(select)
app.command()(simulate)
app.command()(study)
app.add_typer(reproduce, name="reproduce")
app.command()(models)
app.command()(bench)
