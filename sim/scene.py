"""Scene file: robot, drive, world, faults, sequencer orders and solver, checked field by field.

A scene is what happens; how it is solved stands in `[solver]` alone. The `[sequencer]` table is data here: the
simulation knows nothing of a sequencer, whoever runs one reads it.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal, Self

import pydantic
from pydantic import Field

from sim.bodies import OtherBody, check_bodies
from softbot.errors import InputError
from softbot.faults import Fault
from softbot.robot import Robot, robot_from, robot_table
from softbot.toml_file import STRICT, Table, check, override, read_toml
from softbot.tube import strain_difference_from_curvature

CONTROL_PERIOD_S = 0.01
"""Period of the bus and of telemetry [s]; a twin's step divides it, or is a whole number of them (given drives)."""


def steps_per_period(step_s: float) -> int:
    """Steps of the twin in one sample: those in a control period, or one where a step is a whole number of periods.

    Raises InputError for any other step.
    """
    periods = round(step_s / CONTROL_PERIOD_S)
    if periods > 1 and abs(periods * CONTROL_PERIOD_S - step_s) <= 1e-9:
        return 1
    steps = round(CONTROL_PERIOD_S / step_s)
    if steps < 1 or abs(steps * step_s - CONTROL_PERIOD_S) > 1e-9:
        raise InputError(
            f"solver.step_s = {step_s:g}: must divide the control period of {CONTROL_PERIOD_S:g} s; "
            "take 0.01, 0.005, 0.0025, 0.002, 0.001 …"
        )
    return steps


def sample_period_s(step_s: float) -> float:
    """Time that a twin is played for at once [s]: the control period, or the step where that is longer.

    The telemetry has a sample each; in longer steps as many as there are control periods, where the twin fills them in.
    """
    return max(CONTROL_PERIOD_S, step_s)


class Drive(pydantic.BaseModel):
    """The `[drive]` table."""

    model_config = STRICT

    kind: Literal["curvature", "contraction", "pressure", "sequencer"] = Field(
        description="curvature: given; contraction: given muscle strain; pressure: open-loop chamber pressures; "
        "sequencer: closed loop"
    )
    curvature_1_m: float | None = Field(None, ge=0, le=1e6, description="size of the intrinsic curvature, in 1/m")
    contraction: float | None = Field(
        None, ge=0, le=10, description="strain by which the muscle on the inner side contracts, without unit"
    )
    peak_pressure_Pa: float | None = Field(
        None, ge=0, le=1e8, description="highest chamber pressure of the sequence, in pascals"
    )
    co_contraction_Pa: float = Field(0.0, ge=0, le=1e8, description="pressure that every chamber keeps, in pascals")
    period_s: float = Field(
        2.0, ge=1e-3, le=1e5, description="the curvature direction turns once in this time, in seconds"
    )
    direction: Literal[1, -1] = Field(
        1, description="+1 turns the curvature direction right-handedly (rolls left), -1 the other way"
    )
    start_s: float = Field(1.0, ge=0, le=1e6, description="bent by then, and turning from then on, in seconds")
    ramp_s: float = Field(0.5, gt=0, le=1e6, description="time in which the bend grows, ending at start_s, in seconds")
    lead_rad: float | None = Field(
        None,
        ge=-math.pi,
        le=math.pi,
        description="instead of turning in period_s, the curvature is asked for this far ahead of the inner side of "
        "the C as it lies now (feedback of the roll), in radians",
    )
    lag_s: float = Field(0.0, ge=0, le=1e3, description="first-order lag of the curvature, in seconds")

    @pydantic.model_validator(mode="after")
    def _needs_its_size(self) -> Self:
        if self.kind == "curvature" and self.curvature_1_m is None:
            raise ValueError('curvature_1_m: missing; drive.kind = "curvature" needs it')
        if self.kind == "contraction" and self.contraction is None:
            raise ValueError('contraction: missing; drive.kind = "contraction" needs it')
        if self.lead_rad is not None and self.lag_s <= 0.0:
            raise ValueError("lag_s: missing; with lead_rad the curvature needs a lag to turn at a finite speed")
        if self.kind == "pressure" and self.peak_pressure_Pa is None:
            raise ValueError('peak_pressure_Pa: missing; drive.kind = "pressure" needs it')
        return self


class WorldTable(pydantic.BaseModel):
    """The `[world]` table."""

    model_config = STRICT

    gravity_m_s2: float = Field(9.81, ge=0, le=1e3, description="in m/s², downwards")
    ground: Literal["plane", "step", "pipe", "none"] = Field(
        "plane",
        description="plane: a flat floor at z = 0; step: a floor with a step; pipe: a round pipe, its top at z = 0; "
        "none: the robot floats",
    )
    slope_rad: float = Field(
        0.0, ge=0, le=1.5, description="plane, step: inclination of the floor, in radians; axes stay those of the floor"
    )
    slope_heading_rad: float = Field(
        math.pi / 2, ge=-math.pi, le=math.pi, description="downhill, from +x towards +y (the robot's left), in radians"
    )
    step_height_m: float = Field(0.005, gt=0, le=10, description="step: its height, in metres")
    step_distance_m: float = Field(
        0.05, ge=-1e3, le=1e3, description="step: y of its riser (+: to the robot's left), rising outwards, in metres"
    )
    pipe_radius_m: float = Field(0.1, gt=0, le=100, description="pipe: its outer radius, in metres")
    pipe_axis: Literal["across", "along"] = Field(
        "across", description="pipe: across: its axis along y, the robot lies over it; along: parallel to the robot"
    )
    rolling_resistance_N_m: float = Field(
        0.0, ge=0, le=1e3, description="moment M_th that rolling the whole robot has to overcome, in N m"
    )
    friction: float = Field(0.6, ge=0, le=1e6, description="coulomb: coefficient; viscous: N s/m²")
    friction_law: Literal["coulomb", "viscous"] = "coulomb"

    @pydantic.model_validator(mode="after")
    def _plausible(self) -> Self:
        if self.friction_law == "coulomb" and self.friction > 10.0:
            raise ValueError(f"friction = {self.friction:g}: a Coulomb coefficient is 0 … 10")
        return self


class SequencerTable(pydantic.BaseModel):
    """The `[sequencer]` table: orders and tuning of the sequencer."""

    model_config = STRICT

    command: Literal["left", "right", "stop"] = Field("left", description="left, right or stop")
    speed_rev_s: float | None = Field(
        None, gt=0, le=100, description="wanted speed, in revolutions per second; default: at the full lead"
    )
    distance_m: float | None = Field(None, gt=0, le=1e6, description="stop after this distance, in metres")
    recovery: bool = Field(True, description="reverse the curvature when a chamber is dead, and roll on")
    turn_back: bool = Field(
        False,
        description="stopped because it cannot roll as ordered, roll the other way, where what is left pushes it there",
    )
    detection: bool = Field(True, description="find faults; false: none is found, and none answered")
    start_s: float = Field(0.5, ge=0, le=1e6, description="when the order is given, in seconds")
    bend_rad: float | None = Field(
        None,
        gt=0,
        le=6.0,
        description="bend of the C, in radians; default: what the pressure limit allows, at most half a circle",
    )
    lead_rad: float = Field(
        0.8, gt=0, le=math.pi / 2, description="largest lead of the curvature ahead of the C, in radians"
    )
    co_contraction_Pa: float = Field(0.0, ge=0, le=1e8, description="pressure that every chamber keeps, in pascals")
    excitation_Pa: float = Field(
        0.0, ge=0, le=1e8, description="by which the pressure of resting chambers steps up and down, in pascals"
    )
    excitation_period_s: float = Field(
        0.3, ge=0.04, le=1e3, description="in which each chamber gets one such step, in seconds"
    )


class Solver(pydantic.BaseModel):
    """The `[solver]` table."""

    model_config = STRICT

    twin: Literal["rod", "bullet"] = Field("rod", description="rod: reduced-order rod; bullet: PyBullet segments")
    accuracy: Literal["fast", "standard", "reference"] = "standard"
    duration_s: float = Field(11.0, gt=0, le=1e6, description="simulated time, in seconds")
    seed: int = Field(0, ge=0, le=2**63 - 1, description="of every random draw of the run")
    step_s: float | None = Field(
        None, ge=1e-6, le=0.2, description="overrides the step that accuracy chooses, in seconds"
    )
    segments: int | None = Field(None, ge=2, le=200, description="bullet: overrides the number of segments")
    modes: int | None = Field(None, ge=1, le=12, description="rod: overrides the number of bending modes")
    contact_points: int | None = Field(None, ge=6, le=200, description="rod: overrides the number of contact points")
    tolerance: float | None = Field(
        None, gt=0, le=0.1, description="rod: adaptive step that keeps the relative error of a step below this"
    )
    question: Literal["motion", "equilibrium"] = Field(
        "motion", description="motion: what happens; equilibrium: where the bent robot comes to rest, no dynamics"
    )


class Metrics(pydantic.BaseModel):
    """The `[metrics]` table."""

    model_config = STRICT

    steady_after_s: float | None = Field(
        None, ge=0, le=1e6, description="revolutions and displacement count from then, in seconds"
    )


class Scene(pydantic.BaseModel):
    """One scene, complete: what a run needs and all that a run directory must hold to make it again."""

    model_config = STRICT

    robot: Robot
    drive: Drive
    world: WorldTable = WorldTable()
    fault: tuple[Fault, ...] = ()
    body: tuple[OtherBody, ...] = ()
    sequencer: SequencerTable = SequencerTable()
    solver: Solver = Solver()
    metrics: Metrics = Metrics()
    name: str = "scene"

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Self:
        limit = self.robot.max_pressure_Pa if self.drive.kind in ("pressure", "sequencer") else math.inf
        peak = self.drive.peak_pressure_Pa
        if self.drive.kind == "pressure" and peak is not None and peak + self.drive.co_contraction_Pa > limit:
            raise ValueError(
                f"drive.peak_pressure_Pa + drive.co_contraction_Pa = {peak + self.drive.co_contraction_Pa:g}: "
                f"above the robot's limit of {limit:g} Pa; lower one of them"
            )
        both_Pa = self.sequencer.co_contraction_Pa
        if self.drive.kind == "sequencer" and both_Pa > 0.8 * limit:
            raise ValueError(
                f"sequencer.co_contraction_Pa = {both_Pa:g}: leaves nothing to bend with; stay below 80 % of the "
                f"robot's limit of {limit:g} Pa"
            )
        if self.drive.kind == "sequencer" and self.world.ground == "none":
            raise ValueError('world.ground = "none": the sequencer rolls on a floor; use drive.kind "pressure" afloat')
        curvature = self.drive.curvature_1_m
        if curvature is not None and curvature * self.robot.length_m > 2 * math.pi:
            raise ValueError(
                f"drive.curvature_1_m = {curvature:g}: bends a tube of {self.robot.length_m:g} m by more than a full "
                f"circle; at most {2 * math.pi / self.robot.length_m:.3g}"
            )
        if curvature is not None and curvature * self.robot.radius_m >= 1.0:
            raise ValueError(f"drive.curvature_1_m = {curvature:g}: the inner side would fold; stay below 1/radius_m")
        return self

    @pydantic.model_validator(mode="after")
    def _robot_does_it(self) -> Self:
        kind, robot = self.drive.kind, self.robot
        lead_rad, free = self.drive.lead_rad, self.world.ground == "none" and robot.damping_time_s == 0.0
        if free and lead_rad is not None and abs(lead_rad) > 0.5 * math.pi:
            raise ValueError(
                f"drive.lead_rad = {lead_rad:g}: a lag takes back a quarter of a turn at most, and afloat an undamped "
                "robot would spin up without end; take less than π/2, a robot.damping_time_s or a ground"
            )
        if kind in ("pressure", "sequencer") and robot.actuation == "muscle":
            raise ValueError(
                f'drive.kind = "{kind}": presses chambers, and robot.actuation = "muscle" has none; take "contraction" '
                'or "curvature"'
            )
        if robot.tube is not None and self.solver.twin == "bullet":
            raise ValueError('solver.twin = "bullet": its segments do not ovalise as a robot.tube does; take "rod"')
        if kind != "contraction":
            return self
        if robot.tube is None or robot.scaled_pressure is None or self.drive.contraction is None:
            raise ValueError(
                'drive.kind = "contraction": what a contraction bends follows from the wall; give the robot a [tube]'
            )
        tightest_1_m = min(2.0 * math.pi / robot.length_m, 1.0 / robot.radius_m)
        if tightest_1_m < robot.kink_curvature_1_m:  # else it kinks first, which the run reports
            most = strain_difference_from_curvature(
                tightest_1_m * robot.radius_m, robot.scaled_pressure, robot.tube.poisson_ratio
            )
            if self.drive.contraction >= most:
                raise ValueError(
                    f"drive.contraction = {self.drive.contraction:g}: bends a tube of {robot.length_m:g} m by more "
                    f"than a full circle, or folds its inner side; stay below {most:.3g}"
                )
        return self

    @pydantic.model_validator(mode="after")
    def _has_room(self) -> Self:
        world, robot = self.world, self.robot
        if world.ground == "step" and abs(world.step_distance_m) < robot.radius_m:
            raise ValueError(
                f"world.step_distance_m = {world.step_distance_m:g}: the robot starts inside the step; put the riser "
                f"at {robot.radius_m:g} m or more to either side"
            )
        check_bodies(self.body, world, robot.length_m, robot.radius_m)
        if self.body and self.solver.question == "equilibrium":
            raise ValueError(
                'solver.question = "equilibrium": is answered for a robot alone; remove the [[body]] tables, or '
                'ask for "motion"'
            )
        return self

    @pydantic.model_validator(mode="after")
    def _solvable(self) -> Self:
        step_s = self.solver.step_s
        if step_s is not None:
            steps_per_period(step_s)
            if step_s > CONTROL_PERIOD_S + 1e-9 and self.drive.kind in ("pressure", "sequencer"):
                raise InputError(
                    f"solver.step_s = {step_s:g}: longer than the control period of {CONTROL_PERIOD_S:g} s, in which "
                    f'valves are commanded; only drive.kind "curvature" and "contraction" can do without'
                )
        return self

    @property
    def steady_after_s(self) -> float:
        """From when revolutions and displacement count [s]: two cycles after the start, unless stated."""
        if self.metrics.steady_after_s is not None:
            return self.metrics.steady_after_s
        if self.drive.kind == "sequencer":
            return self.sequencer.start_s + 2.0
        return self.drive.start_s + 2.0 * self.drive.period_s

    def table(self) -> Table:
        """The scene as the tables of a scene file, every default written out."""
        table = self.model_dump(by_alias=True, exclude_none=True, mode="json")
        return {key: value for key, value in table.items() if value not in ({}, [])}


def load_scene(path: Path, assignments: tuple[str, ...] = ()) -> Scene:
    """A scene file with `--set` assignments laid over it. Raises InputError that names file, key and mend.

    `robot = "file.toml"` is read from the scene's folder; assignments reach into it as into any table.
    """
    return scene_from(read_toml(path), str(path), path.parent, assignments)


def place_of_robot(path: Path, assignments: tuple[str, ...] = ()) -> str:
    """Where the robot of a scene file stands, as errors name it before a key: `robot.toml: `, or `scene.toml: robot.`

    An assignment that reaches into the robot counts as the scene's own, as it does in the errors of `load_scene`.
    """
    named, rest = _named_robot(assignments)
    robot = named or read_toml(path).get("robot")
    if isinstance(robot, str) and not any(one.strip().startswith("robot.") for one in rest):
        return f"{robot_table(robot, path.parent)[1]}: "
    return f"{path}: robot."


def _named_robot(assignments: tuple[str, ...]) -> tuple[str | None, tuple[str, ...]]:
    """The robot file that is assigned, if one is, and the other assignments."""
    named = next((a.split("=", 1)[1] for a in assignments if a.split("=", 1)[0].strip() == "robot" and "=" in a), None)
    if named is None:
        return None, assignments
    return named.strip().strip('"'), tuple(a for a in assignments if a.split("=", 1)[0].strip() != "robot")


def scene_from(table: Table, source: str, folder: Path, assignments: tuple[str, ...] = ()) -> Scene:
    """A scene from its tables; `folder` is where a robot file is looked for."""
    named, assignments = _named_robot(assignments)
    tables: dict[str, Any] = dict(table)
    if named is not None:
        tables["robot"] = named
    robot = tables.get("robot")
    if isinstance(robot, str):
        tables["robot"], robot_source = robot_table(robot, folder)
        robot_from(tables["robot"], robot_source)  # name the robot's own file in its errors
    tables.setdefault("name", Path(source).stem)
    tables = override(tables, assignments)
    scene = check(Scene, tables, source)
    if scene.metrics.steady_after_s is not None and scene.metrics.steady_after_s >= scene.solver.duration_s:
        raise InputError(
            f"{source}: metrics.steady_after_s = {scene.metrics.steady_after_s:g}: not before the end at "
            f"solver.duration_s = {scene.solver.duration_s:g}"
        )
    return scene
