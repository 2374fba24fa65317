"""`softbot demo`: the paper's experiment, from a measured table to a robot that rolls on with three chambers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from softbot.cli.options import Assignments, Gui, Json, Out, WallClock

if TYPE_CHECKING:
    from calib.calibration import Calibration
    from sim.scene import Scene

ROBOT_NAME = "asu_four_chamber_arm"
LENGTH_M = 0.134
"""Of the link at rest, from the data's own description; the table has the loaded lengths only."""


def demo(
    out: Out = None,
    assignments: Assignments = None,
    json: Json = False,
    gui: Gui = False,
    wall_clock: WallClock = False,
) -> None:
    """Run the paper's experiment.

    Calibrate the robot against its measured table, bend it, roll, lose a chamber, notice, reverse the curvature and
    roll on. The run folder holds the calibrated robot and its figure beside what `run` writes.
    """
    import typer

    from calib.figure import save_figure
    from softbot.cli.perform import perform
    from softbot.cli.run_folder import open_run_folder
    from softbot.cli.streams import messages
    from softbot.nodes.plant_node import board_limits
    from softbot.toml_file import write_toml

    with messages().status("calibrating the robot"):
        calibration = calibrate_shipped_table()
        scene = demo_scene(calibration, tuple(assignments or ()))
        board_limits(scene.robot)  # refused before a folder is made
        folder = open_run_folder(scene.name, out)
        write_toml(folder / "robot.toml", calibration.robot_table(ROBOT_NAME))
        save_figure(calibration, folder / "calibration.png")
    if not json:
        typer.echo(calibration_sentence(calibration))
    perform(scene, folder, json=json, gui=gui, wall_clock=wall_clock)


def calibrate_shipped_table() -> Calibration:
    """The actuator law fitted to the shipped four-chamber table: the default robot, made again."""
    from dataclasses import replace
    from importlib import resources

    from calib.fit import calibrate_table
    from calib.model_choice import Geometry
    from calib.table import read_table

    with resources.as_file(resources.files("calib") / "data" / ROBOT_NAME / "table.csv") as path:
        table = replace(read_table(path), source=f"calib/data/{ROBOT_NAME}/table.csv")  # the same on every machine
    return calibrate_table(table, Geometry(length_m=LENGTH_M))


def demo_scene(calibration: Calibration, assignments: tuple[str, ...] = ()) -> Scene:
    """The shipped scene with the calibrated robot, and assignments laid over it."""
    from importlib import resources

    from sim.scene import scene_from
    from softbot.toml_file import read_toml

    with resources.as_file(resources.files("softbot") / "data" / "demo.toml") as path:
        tables = read_toml(path)
    tables["robot"] = calibration.robot_table(ROBOT_NAME)
    return scene_from(tables, "demo.toml", Path(), assignments)


def calibration_sentence(calibration: Calibration) -> str:
    """What the calibration came to, in a sentence."""
    found = calibration.report()
    return (
        f"Calibrated {ROBOT_NAME} on {found['rows']} loading rows: {found['law']} wall, bend within "
        f"{found['rms_bend_percent']:.1f} % of full scale (the table repeats itself to "
        f"{found['repeat_bend_percent']:.1f} %)."
    )
