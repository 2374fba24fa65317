"""`softbot report`: the HTML report of a run folder, made again; also of a run that was killed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from softbot.cli.options import Json


def report(
    run_dir: Annotated[Path, typer.Argument(metavar="RUN_DIR", help="Folder of a run.")],
    still: Annotated[Path | None, typer.Option(metavar="PNG", help="Also draw the roll as one picture.")] = None,
    json: Json = False,
) -> None:
    """Write the report of a run folder. A run that was killed is finished first, from what it left."""
    from softbot.cli.perform import print_outcome
    from softbot.cli.streams import messages
    from softbot.cli.written_file import can_be_written

    if still is not None:
        can_be_written("--still", still, (".png",))
    with messages().status("writing the report"):
        from softbot.nodes.killed_run import finish_killed_run, was_killed
        from softbot.report import write_report

        if was_killed(run_dir):
            finish_killed_run(run_dir)
        write_report(run_dir)
        if still is not None:
            from softbot.report.still import write_still

            write_still(run_dir, still)
    print_outcome(run_dir, json=json)
