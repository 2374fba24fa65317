"""`softbot inverse`: pressures for a wanted bend, and how exactly they reach it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from softbot.cli.options import Json

if TYPE_CHECKING:
    from softbot.robot import Robot

_ROUNDING = 1e-9  # of a bend: a component below is none, and its sign has nothing to say


def inverse(
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="Robot file (TOML), or default.")],
    bend_deg: Annotated[float, typer.Option(help="Wanted bend, less than a full circle.")] = 30.0,
    direction_deg: Annotated[
        float, typer.Option(help="Body angle of the inner side of the C; chamber 0 lies at 0, chamber 1 at 90.")
    ] = 0.0,
    length_mm: Annotated[float | None, typer.Option(help="Wanted length; without it the least pressures.")] = None,
    dead: Annotated[list[int] | None, typer.Option(help="Chamber that cannot be used; many times.")] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Override a key of the robot; many times.")
    ] = None,
    check: Annotated[bool, typer.Option("--check", help="Errors over the workspace and through hysteresis.")] = False,
    json: Json = False,
) -> None:
    """Pressures that bend a robot as wanted; with --check, how exactly, over the workspace and through hysteresis."""
    import json as json_format
    import math

    from softbot.cross_section import CHAMBERS
    from softbot.errors import InputError
    from softbot.prediction import FULL_CIRCLE_DEG
    from softbot.robot import robot_from, robot_table
    from softbot.toml_file import override

    for option, value in (("--bend-deg", bend_deg), ("--direction-deg", direction_deg), ("--length-mm", length_mm)):
        if value is not None and not math.isfinite(value):
            raise InputError(f"{option} {value:g}: give a finite number")
    if not abs(bend_deg) < FULL_CIRCLE_DEG:
        raise InputError(
            f"--bend-deg {bend_deg:g}: at {FULL_CIRCLE_DEG:g} the arc is a full circle, whose ends touch; give less"
        )
    unusable = tuple(dict.fromkeys(dead or ()))
    if any(chamber not in range(CHAMBERS) for chamber in unusable):
        raise InputError(f"--dead {list(unusable)}: name chambers of 0 to {CHAMBERS - 1}")
    table, source = robot_table(robot, Path())
    one = robot_from(override(table, settings or []), source)
    answer = _checked(one) if check else _asked(one, bend_deg, direction_deg, length_mm, unusable)
    if json:
        print(json_format.dumps(answer, allow_nan=False))
    elif check:
        _show_check(answer)
    else:
        for key, value in answer.items():
            if value is None:  # nothing was asked of it
                continue
            shown = ", ".join(f"{each:.2f}" for each in value) if isinstance(value, list) else value
            typer.echo(f"{key}: {f'{shown:.2f}' if isinstance(shown, float) else shown}")


def _asked(
    robot: Robot, bend_deg: float, direction_deg: float, length_mm: float | None, dead: tuple[int, ...]
) -> dict[str, Any]:
    import math

    import numpy as np

    from controllers.compensation import Compensator
    from softbot.cross_section import CHAMBERS
    from softbot.prediction import HELD_S

    size, angle = math.radians(bend_deg) / robot.length_m, math.radians(direction_deg)
    compensator = Compensator(robot.actuator_law(), robot.actuator_memory())
    found = compensator.pressures(
        [size * math.cos(angle), size * math.sin(angle)],
        dt_s=HELD_S,
        limit_Pa=robot.max_pressure_Pa,
        available=[chamber not in dead for chamber in range(CHAMBERS)],
        stretch=None if length_mm is None else 1e-3 * length_mm / robot.length_m,
    )
    bend = robot.length_m * found.curvature_1_m
    bend = np.where(np.abs(bend) > _ROUNDING * np.hypot(*bend), bend, 0.0)
    return {
        "pressure_kPa": [float(one) for one in found.pressure_Pa / 1e3],
        "bend_deg": math.degrees(float(np.hypot(*bend))),
        "direction_deg": math.degrees(math.atan2(bend[1], bend[0])),
        "length_mm": 1e3 * robot.length_m * found.stretch,
        "bend_reached": found.reached,
        "length_reached": None if length_mm is None else found.stretch_reached,
    }


def _checked(robot: Robot) -> dict[str, Any]:
    from dataclasses import asdict

    from controllers.inverse_check import compensation_error, typical_hysteresis, workspace_error

    law, limit_Pa = robot.actuator_law(), robot.max_pressure_Pa
    own = None if robot.memory is None else robot.memory.hysteresis
    through = compensation_error(law, own or typical_hysteresis(limit_Pa), limit_Pa)
    return {
        "workspace": [asdict(one) for one in workspace_error(law, limit_Pa)],
        "hysteresis": "the robot's own" if own else "made up, as wide as published ones: the robot file has none",
        "compensation": asdict(through) | {"ratio": through.ratio},
    }


def _show_check(answer: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title="inverse, then forward: largest errors in %", title_justify="left")
    for heading in ("dead", "bends", "bend", "bend, with stretch", "stretch"):
        table.add_column(heading, justify="right")
    for one in answer["workspace"]:
        errors = (f"{one[key]:.4f}" for key in ("bend_percent", "bend_with_stretch_percent", "stretch_percent"))
        table.add_row(" ".join(map(str, one["dead"])) or "none", str(one["samples"]), *errors)
    console = Console()
    console.print(table)
    found = answer["compensation"]
    typer.echo(
        f"through hysteresis ({answer['hysteresis']}), rms error in % of the largest bend: "
        f"{found['without_percent']:.2f} without compensation, {found['with_percent']:.4f} with it, "
        f"{found['tenth_off_percent']:.2f} with its parameters a tenth off (ratio {found['ratio']:.2f})"
    )
