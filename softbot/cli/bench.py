"""`softbot bench`: run time against error of the twins."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from softbot.cli.options import Json


def bench(
    twin: Annotated[str, typer.Option(help="rod, bullet or all")] = "all",
    repeats: Annotated[int, typer.Option(min=1, max=100, help="Runs of each setting; the median time counts.")] = 3,
    out: Annotated[Path | None, typer.Option(help="Write the table as Markdown, stamped with what it ran on.")] = None,
    json: Json = False,
) -> None:
    """Measure the twins against theory.

    Floating ratio and advance ratio at several resolutions, with the error and the multiple of real time.
    """
    import json as json_format
    from dataclasses import asdict

    from softbot.cli.streams import messages, nothing_printed
    from softbot.errors import InputError

    with nothing_printed():
        from sim.benchmark import BULLET_SETTINGS, ROD_SETTINGS, markdown, run_benchmark, segment_twin_at_4_ms, stamp

    choice = {"rod": ROD_SETTINGS, "bullet": BULLET_SETTINGS, "all": (*ROD_SETTINGS, *BULLET_SETTINGS)}
    if twin not in choice:
        raise InputError(f"--twin {twin}: choose one of {', '.join(choice)}")
    results = []
    with messages().status("measuring (minutes; the first run compiles)") as status:
        for result in run_benchmark(choice[twin], repeats):
            results.append(result)
            status.update(f"{result.case}: {result.setting}: {result.error_percent:+.2f} %")
        if twin != "rod":
            results.append(segment_twin_at_4_ms(repeats))
    if out is not None:
        text = f"# Run time against error\n\n`softbot bench --twin {twin} --repeats {repeats}`: {stamp()}\n\n"
        try:
            out.write_text(text + markdown(results) + "\n", encoding="utf-8")
        except OSError as error:
            raise InputError(f"{out}: cannot be written: {error.strerror}; choose another --out") from None
    if json:
        typer.echo(json_format.dumps({"machine": stamp(), "results": [asdict(result) for result in results]}))
    else:
        typer.echo(markdown(results))
