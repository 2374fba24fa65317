"""The command line: `softbot --help`. Everything heavy is imported by the command that needs it, when it runs."""


def main() -> None:
    """The `softbot` command."""
    from softbot.one_thread import keep_to_one_thread

    keep_to_one_thread()
    from softbot.cli.app import app

    app()
