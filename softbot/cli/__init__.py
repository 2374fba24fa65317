"""The command line: `softbot --help`. Everything heavy is imported by the command that needs it, when it runs."""


def main() -> None:
    """The `softbot` command."""
    import gc
    import sys

    from softbot.one_thread import keep_to_one_thread

    gc.set_threshold(50_000)  # a start makes many objects and drops few: 5 % of it went into looking for those
    keep_to_one_thread()
    from softbot.cli.app import app

    try:
        app()
    except OSError as error:  # help and version are said outside the commands (`softbot.cli.exit_status`)
        print(f"softbot: {error.strerror or error}", file=sys.stderr)
        sys.exit(2)
