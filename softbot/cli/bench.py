"""`softbot bench`: run time against error, of the twins and of other engines."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from softbot.cli.options import Json

if TYPE_CHECKING:
    from sim.scene import Scene

_QUICK_SETTINGS = 1


def bench(
    case: Annotated[
        list[str] | None, typer.Option(help="Case to measure; may be given many times. Default: all.")
    ] = None,
    engine: Annotated[
        list[str] | None, typer.Option(help="rod, bullet, mujoco or pyelastica; may be given many times. Default: all.")
    ] = None,
    repeats: Annotated[int, typer.Option(min=1, max=100, help="Runs of each setting; the median time counts.")] = 3,
    quick: Annotated[bool, typer.Option("--quick", help="One setting of each engine, run once.")] = False,
    scaling: Annotated[
        bool, typer.Option("--scaling", help="Also how the rod's cost grows: modes, points, length of run, robots.")
    ] = False,
    figure: Annotated[Path | None, typer.Option(help="Draw the work-precision picture (.png, .svg, .pdf).")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Write the answer, stamped with what it ran on: Markdown, or JSON for a .json.")
    ] = None,
    json: Json = False,
) -> None:
    """Measure the twins and their peers against theory.

    Wall time per simulated second and error, for a floating, a rolling, a hanging and a vibrating rod and for the
    experiment. MuJoCo and PyElastica are measured where they are installed (the extra "bench").
    """
    import json as json_format

    from softbot.cli.streams import messages, nothing_printed
    from softbot.cli.written_file import PICTURES, can_be_written

    if out is not None:
        can_be_written("--out", out)
    if figure is not None:
        can_be_written("--figure", figure, PICTURES)
    with nothing_printed():
        from sim.benchmark import cases, engines, measure
        from sim.benchmark.scaling import growth
        from sim.benchmark.stamp import stamp
        from sim.benchmark.table import fastest_markdown, growth_markdown, markdown
    chosen_cases = _chosen("--case", cases(), case)
    chosen_engines = _chosen("--engine", engines(), engine)
    results, grown = [], []
    with messages().status("measuring (minutes; the first run compiles)") as status, nothing_printed(quiet=False):
        for result in measure(
            chosen_cases,
            chosen_engines,
            repeats=1 if quick else repeats,
            settings_each=_QUICK_SETTINGS if quick else None,
            run=_run,
        ):
            results.append(result)
            status.update(f"{result.case}: {result.engine} {result.setting}")
        if scaling:
            for row in growth(repeats=1 if quick else repeats, run_many=_run_many, quick=quick):
                grown.append(row)
                status.update(f"{row.of}: {row.size:g}")
    machine = stamp(chosen_engines)
    answer: dict[str, Any] = {"machine": machine, "results": [result.row() for result in results]}
    text = (
        f"Fastest settings within 1 %, or else the nearest: × real time at their error\n\n{fastest_markdown(results)}"
    )
    text += f"\n\nAll settings\n\n{markdown(results)}"
    if scaling:
        answer["scaling"] = [row.row() for row in grown]
        text += f"\n\nHow the rod's cost grows\n\n{growth_markdown(grown)}"
    answer_json = json_format.dumps(answer)
    if out is not None:
        _write(out, answer_json if out.suffix == ".json" else _page(text, machine))
    if figure is not None:
        _draw(figure, chosen_cases, results, machine)
    typer.echo(answer_json if json else text)


def _chosen(option: str, known: Any, wanted: list[str] | None) -> list[Any]:
    from softbot.errors import InputError

    by_name = {each.name: each for each in known}
    for name in wanted or ():
        if name not in by_name:
            raise InputError(f"{option} {name}: choose from {', '.join(by_name)}")
    return [each for each in known if not wanted or each.name in wanted]


def _run(scene: Scene) -> dict[str, Any]:
    from softbot.nodes.run import run_scene

    return run_scene(scene).summary


def _run_many(scenes: Any) -> None:
    from sim.run_many import run_many

    run_many(scenes)


def _page(text: str, machine: dict[str, Any]) -> str:
    from sim.benchmark.stamp import in_words

    return f"# Run time against error\n\n`softbot bench`: {in_words(machine)}\n\n{text}\n"


def _write(path: Path, text: str) -> None:
    from softbot.errors import InputError

    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}; choose another --out") from None


def _draw(path: Path, cases: list[Any], results: list[Any], machine: dict[str, Any]) -> None:
    from sim.benchmark.figure import draw
    from sim.benchmark.stamp import in_words
    from softbot.errors import InputError

    try:
        draw(path, cases, results, in_words(machine))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be drawn: {error}; choose another --figure, such as bench.png") from None
