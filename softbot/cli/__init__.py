"""The command line: `softbot --help`. Everything heavy is imported by the command that needs it, when it runs."""


def main() -> None:
    """The `softbot` command."""
    import gc

    from softbot.one_thread import keep_to_one_thread

    gc.set_threshold(50_000)  # a start makes many objects and drops few: 5 % of it went into looking for those
    keep_to_one_thread()
    from softbot.cli.app import app

    app()
