"""The command line: `softbot --help`. Everything heavy is imported by the command that needs it, when it runs."""


def main() -> None:
    """The `softbot` command."""
    from softbot.cli.app import app

    app()
