"""`softbot campaign`: thousands of runs drawn from distributions, their table and their report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from softbot.cli.options import Json


def campaign(
    campaign: Annotated[
        Path, typer.Argument(metavar="CAMPAIGN.toml", help="Campaign file, or the folder of a campaign to go on with.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of the campaign; one that was begun there goes on. Default: runs/NAME."),
    ] = None,
    assignments: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="A.B=VALUE",
            help="Override a value of the campaign, as scene.solver.duration_s=20; may be given many times.",
        ),
    ] = None,
    runs: Annotated[int | None, typer.Option(help="Number of runs, in place of the file's.")] = None,
    processes: Annotated[int | None, typer.Option(min=1, help="Processes. Default: one for each core.")] = None,
    matters: Annotated[
        bool,
        typer.Option(
            "--matters",
            help="Make each run of a single fault twice more, without it and with it unanswered: does it matter?",
        ),
    ] = False,
    scheduler: Annotated[
        str | None, typer.Option(metavar="tcp://HOST:PORT", help="A Dask scheduler, whose workers make the runs.")
    ] = None,
    replay: Annotated[
        int | None, typer.Option(metavar="RUN", help="Make this one run on the bus, with telemetry and report.")
    ] = None,
    compare: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="Make the first N runs again over a bus, and tell in how many the verdict is the same."
        ),
    ] = None,
    twin: Annotated[
        str,
        typer.Option(metavar="rod|bullet", help="--compare: the twin to make them with; bullet: PyBullet's segments."),
    ] = "rod",
    interface: Annotated[str | None, typer.Option(help="--compare: bus to make them over. Default: virtual.")] = None,
    channel: Annotated[str, typer.Option(help="--compare: channel of that bus.")] = "vcan0",
    json: Json = False,
) -> None:
    """Make the runs of a campaign.

    Its folder holds every run's row as soon as it is made, so that a campaign that was interrupted goes on where it
    stopped; at the end results.parquet and report.html.
    """
    import json as json_format

    from softbot.campaign.campaign import load_campaign
    from softbot.campaign.execution import CAMPAIGN_FILE, campaign_in
    from softbot.errors import InputError

    if replay is not None and compare is not None:
        raise InputError("--replay and --compare: give one of them; each makes runs of its own")
    given = list(assignments or [])
    if runs is not None:
        given.append(f"runs={runs}")
    if matters:
        given.append("matters=true")
    folder = out
    if campaign.is_dir():
        if (campaign / CAMPAIGN_FILE).exists() and not given:
            draws, folder = campaign_in(campaign), folder or campaign
        else:
            draws, folder = load_campaign(campaign / CAMPAIGN_FILE, tuple(given)), folder or campaign
    else:
        draws = load_campaign(campaign, tuple(given))
    folder = folder or Path("runs") / draws.campaign.name
    if replay is not None:
        _replay(draws, replay, folder, json=json)
        return
    if compare is not None:
        _compare(draws, compare, twin, None if interface is None else (interface, channel), processes, json=json)
        return
    found = _carry_out(draws, folder, processes, scheduler)
    if json:
        typer.echo(json_format.dumps(found, allow_nan=False))
    else:
        _show(found, folder)


def _replay(draws: Any, number: int, folder: Path, *, json: bool) -> None:
    from softbot.cli.perform import perform
    from softbot.cli.run_folder import open_run_folder
    from softbot.errors import InputError
    from softbot.nodes.plant_node import board_limits

    if not 0 <= number < draws.campaign.runs:
        raise InputError(f"--replay {number}: the campaign has runs 0 to {draws.campaign.runs - 1}")
    run = draws.run(number)
    board_limits(run.known or run.scene.robot)  # refused before a folder is made
    perform(run.scene, open_run_folder(run.scene.name, folder / f"run-{number}"), json=json, known=run.known)


def _compare(
    draws: Any, count: int, twin: str, transport: tuple[str, str] | None, processes: int | None, *, json: bool
) -> None:
    import json as json_format

    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from softbot.campaign.comparison import compare, summary_of
    from softbot.campaign.statistics import percent
    from softbot.cli.compiling import told_of_compiling
    from softbot.cli.perform import import_twin, prepare
    from softbot.cli.streams import messages, nothing_printed
    from softbot.errors import InputError
    from softbot.nodes.direct import warm_up

    if not 0 < count <= draws.campaign.runs:
        raise InputError(f"--compare {count}: the campaign has {draws.campaign.runs} runs; give 1 to that")
    if twin not in ("rod", "bullet"):
        raise InputError(f"--twin {twin}: there are rod and bullet")
    first = draws.run(0).scene
    again = first.model_copy(update={"solver": first.solver.model_copy(update={"twin": twin})})
    import_twin(again)
    with nothing_printed(quiet=False), told_of_compiling("preparing", "compiling the twins, once on this machine"):
        warm_up(first)
        prepare(again)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    console = messages()
    with (
        Progress(*columns, console=console, transient=True, disable=console.quiet) as bar,
        nothing_printed(quiet=False),
    ):
        task = bar.add_task(f"{draws.campaign.name} on {twin}", total=count)
        found = compare(
            draws,
            range(count),
            twin=twin,
            transport=transport,
            processes=processes,
            told=lambda one: bar.update(task, advance=1),
        )
    told = {"twin": twin, "bus": "virtual" if transport is None else " ".join(transport), **summary_of(found)}
    if json:
        typer.echo(json_format.dumps(told, allow_nan=False))
        return
    typer.echo(
        f"the same verdict in {told['same']} of {told['runs']} runs ({percent(told['same_share'])}), made again with "
        f"the {twin} twin over a {told['bus']} bus"
    )
    if told["found_later_median_s"] is not None:
        typer.echo(f"found later there, median: {told['found_later_median_s']:.2f} s")
    for one in told["others"]:
        typer.echo(
            f"run {one['run']} ({one['case']}): {_said(one['campaign'])} in the campaign, {_said(one['again'])} there"
        )


def _said(verdict: dict[str, Any]) -> str:
    if verdict["failed"] is not None:
        return f"failed ({verdict['failed']})"
    named = "; ".join(verdict["named"]) or "nothing struck"
    return named + (", false alarm" if verdict["alarmed"] else "")


def _carry_out(draws: Any, folder: Path, processes: int | None, scheduler: str | None) -> dict[str, Any]:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from softbot.campaign.execution import carry_out
    from softbot.campaign.page import write_page
    from softbot.campaign.statistics import Tally, statistics
    from softbot.cli.compiling import told_of_compiling
    from softbot.cli.streams import messages, say
    from softbot.nodes.direct import warm_up

    with told_of_compiling("preparing", "compiling twin and controller, once on this machine: about a minute"):
        warm_up(draws.run(0).scene)
    console, tally = messages(), Tally()
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]:.1f} runs/s"),
        TextColumn("{task.fields[found]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True, disable=console.quiet) as bar:
        task = bar.add_task(draws.campaign.name, total=draws.campaign.runs, rate=0.0, found="")

        def told(row: dict[str, Any]) -> None:
            tally.add(row)
            bar.update(task, advance=1, rate=tally.rate(), found=tally.words())

        try:
            table = carry_out(
                draws,
                folder,
                processes=processes,
                scheduler=scheduler,
                told=told,
                begun=lambda done: bar.update(task, completed=done),
            )
        except BaseException:
            bar.stop()
            if (made := int(bar.tasks[task].completed)) > 0:
                say(f"{made} of {draws.campaign.runs} runs are kept in {folder}; the same command makes the others")
            raise
    with messages().status("writing the report"):
        found = statistics(table)
        write_page(draws, table, found, folder)
    return found


def _show(found: dict[str, Any], folder: Path) -> None:
    from rich.console import Console
    from rich.table import Table

    from softbot.campaign.statistics import lines

    console = Console()
    table = Table(show_header=False, box=None, pad_edge=False)
    for name, value in lines(found):
        table.add_row(name, value)
    console.print(table)
    for name in ("report.html", "results.parquet"):
        console.print(f"{name:16} {folder / name}", soft_wrap=True, highlight=False)
