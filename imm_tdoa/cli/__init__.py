"""The command ``imm-tdoa``: track, locate, simulate, models."""

from imm_tdoa.cli.app import app


def main() -> None:
    """Run the command: 0 when all went well, 2 and one line on stderr when not, 130 on Ctrl-C."""
    app(prog_name="imm-tdoa")


__all__ = ["app", "main"]
