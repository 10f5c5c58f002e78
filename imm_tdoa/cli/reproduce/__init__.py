"""``imm-tdoa reproduce``: published comparisons, computed again."""

import typer

from imm_tdoa.cli.reproduce.motion_form import motion_form
from imm_tdoa.cli.reproduce.phase_difference import phase_difference
from imm_tdoa.cli.reproduce.receiver_errors import receiver_errors
from imm_tdoa.cli.reproduce.sequence_filter import sequence_filter

app = typer.Typer(invoke_without_command=True)


@app.callback()
def reproduce(context: typer.Context) -> None:
    """Compute published comparisons again, beside the published figures.

    Example, TDOA location by the form of the target's motion:

        imm-tdoa reproduce motion-form

    `imm-tdoa reproduce NAME --help` says what each computes and writes.
    """
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


app.command("motion-form")(motion_form)
app.command("phase-difference")(phase_difference)
app.command("receiver-errors")(receiver_errors)
app.command("sequence-filter")(sequence_filter)
