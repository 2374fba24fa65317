"""The command line: `softbot --help`. Everything heavy is imported by the command that needs it, when it runs."""


def main() -> None:
    """The `softbot` command."""
    import gc
    import sys

    from softbot.one_thread import keep_to_one_thread

    gc.set_threshold(50_000)  # a start makes many objects and drops few: 5 % of it went into looking for those
    keep_to_one_thread()
    from softbot.cli.app import app
    from softbot.cli.exit_status import in_words

    try:
        app()
    except OSError as error:  # help and version are said outside the commands (`softbot.cli.exit_status`)
        print(f"softbot: {in_words(error)}", file=sys.stderr)
        sys.exit(2)
    finally:
        _forget_what_cannot_be_written()


def _forget_what_cannot_be_written() -> None:
    """Otherwise Python tries once more when it ends, and complains of it in its own words."""
    import contextlib
    import os
    import sys

    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError:
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
