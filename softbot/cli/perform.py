"""One scene run and reported, as `run` and `demo` do it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from softbot.cli.streams import messages, nothing_printed, progress_bar

if TYPE_CHECKING:
    from sim.scene import Scene
    from softbot.robot import Robot


def perform(
    scene: Scene,
    folder: Path,
    *,
    json: bool,
    gui: bool = False,
    wall_clock: bool = False,
    known: Robot | None = None,
) -> None:
    """Run a scene into a folder, write its report, and print the outcome (`json`: the summary and nothing else).

    known: the robot that controller and board believe in, where it is another than the scene's.
    """
    from softbot.cli.run_folder import held

    import_twin(scene)
    with held(folder), nothing_printed(quiet=False) if json or gui else contextlib.nullcontext():
        from softbot.cli.compiling import told_of_compiling

        with told_of_compiling("preparing", _what_is_compiled(scene)):
            prepare(scene)
        from softbot.nodes.run import paced, run_scene

        with (
            kept(folder),
            reported_when_interrupted(folder),
            progress_bar(f"{scene.name}, {scene.solver.twin} twin", scene.solver.duration_s) as show,
        ):
            run_scene(scene, folder, progress=paced(show) if wall_clock else show, gui=gui, known=known)
        with messages().status("writing the report"):
            from softbot.report import write_report

            write_report(folder)
    print_outcome(folder, json=json)


def _what_is_compiled(scene: Scene) -> str:
    twin = "rod twin" if scene.solver.twin == "rod" else "segment twin"
    if scene.drive.kind == "sequencer":
        return f"compiling {twin}, plant and controller, once on this machine: a minute or two"
    return f"compiling the {twin}, once on this machine: about 20 seconds"


def prepare(scene: Scene) -> None:
    """Import, check and compile what the run will use, so that it starts at once."""
    from sim.plan import GIVEN
    from softbot.nodes.warm_up import warm_up

    if scene.drive.kind == "sequencer":
        from softbot.nodes.plant_node import board_limits

        board_limits(scene.robot)  # refuse what the board would refuse before anything is computed
    from softbot.nodes.compiling_aside import ROD, SEQUENCER, compiled_aside

    rod = (ROD,) if scene.solver.twin == "rod" else ()
    if scene.drive.kind == "sequencer":
        from softbot.nodes.rehearsal import rehearse_sequencer

        with compiled_aside(scene, SEQUENCER, *rod):
            warm_up(scene)
        rehearse_sequencer(scene)
    else:
        with compiled_aside(scene, *rod):
            warm_up(scene)
    if scene.drive.kind not in GIVEN:
        from softbot.nodes.valve_loop import designed_gains

        designed_gains(scene.robot)  # kept for the run


def print_outcome(folder: Path, *, json: bool) -> None:
    """The run in a folder, in words and numbers, or its summary as it stands in the file."""
    import typer

    if json:
        typer.echo((folder / "summary.json").read_text(encoding="utf-8"), nl=False)
        return
    from softbot.cli.outcome import show

    show(folder)


@contextlib.contextmanager
def kept(folder: Path) -> Iterator[None]:
    """Say where the recording is when the run inside does not come to its end."""
    import typer

    try:
        yield
    except BaseException:
        if (folder / "summary.json").exists():
            typer.echo(f"softbot: what was recorded is kept in {folder}", err=True)
        raise


@contextlib.contextmanager
def reported_when_interrupted(folder: Path) -> Iterator[None]:
    """A run that is stopped on the way has a report of what there is, where it came far enough for one."""
    from softbot.errors import SoftbotError

    try:
        yield
    except KeyboardInterrupt:
        with contextlib.suppress(SoftbotError, OSError):
            from softbot.report import write_report

            write_report(folder)
        raise


def import_twin(scene: Scene) -> None:
    """PyBullet greets on standard error when it is imported: once, here, unheard."""
    if scene.solver.twin == "bullet":
        with nothing_printed():
            import pybullet  # noqa: F401
