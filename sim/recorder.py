"""Run directory: scene, telemetry, shapes and summary of one run, written as it happens."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from sim.body import Motion, Twin
from sim.scene import CONTROL_PERIOD_S, Scene
from sim.summary import Cost, Events, summarise, write_summary
from sim.telemetry import FLUSH_ROWS, SHAPE_SCHEMA, TELEMETRY_SCHEMA, TableWriter, read_telemetry
from sim.trajectory import Posture, Trajectory, wrapped
from softbot.cross_section import CHAMBER_ANGLES_RAD
from softbot.errors import InputError
from softbot.faults import Fault
from softbot.toml_file import write_toml

FloatArray = NDArray[np.float64]

SHAPE_EVERY = 4  # samples: 25 a second
_NO_PRESSURE = np.full(5, np.nan)


class Recorder:
    """Records one run, into `run_dir` or (None) into memory. Also the run's clock: it times the solver loop alone."""

    def __init__(self, scene: Scene, run_dir: Path | None) -> None:
        self._scene, self._run_dir = scene, run_dir
        self._trajectory = Trajectory(scene.robot.length_m, grounded=scene.world.ground != "none")
        self._rows: list[dict[str, Any]] = []
        self._samples = 0
        self._writer: TableWriter | None = None
        self.events = Events()
        self._wall_s, self._started_s = 0.0, 0.0
        if run_dir is not None:
            try:
                run_dir.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise InputError(f"{run_dir}: cannot be made: {error.strerror}; choose another --out") from None
            for earlier in ("summary.json", "report.html", "bus.log"):
                (run_dir / earlier).unlink(missing_ok=True)
            write_toml(run_dir / "scene.toml", scene.table())
            self._writer = TableWriter(run_dir, "telemetry", TELEMETRY_SCHEMA)
            radius = {b"radius_m": f"{scene.robot.radius_m:.9g}".encode()}
            self._shapes = TableWriter(run_dir, "shape", SHAPE_SCHEMA.with_metadata(radius), FLUSH_ROWS // SHAPE_EVERY)

    def start_clock(self) -> None:
        """The solver loop runs from here …"""
        self._started_s = time.perf_counter()

    def stop_clock(self) -> None:
        """… to here; recording between the two is not counted."""
        self._wall_s += time.perf_counter() - self._started_s

    def note_faults(self, struck: Iterable[Fault]) -> None:
        """Faults that have just struck, for the summary."""
        self.events.faults += [{"t_s": f.t_s, "chamber": f.chamber, "kind": str(f.kind)} for f in struck]

    def sample(
        self,
        t_s: float,
        twin: Twin,
        motion: Motion,
        *,
        pressure_Pa: FloatArray = _NO_PRESSURE,
        command_Pa: FloatArray = _NO_PRESSURE,
        active_rad: float = math.nan,
        state: str = "",
    ) -> Posture:
        """Record one row. `active_rad`: body angle of the active side; `pressure_Pa`: chambers and manifold, true."""
        posture = self._trajectory.follow(motion)
        if math.isnan(active_rad):
            active_rad = active_side_rad(pressure_Pa[:4])
        row = {
            "t_s": t_s,
            **{f"pressure_{i}_Pa": float(pressure_Pa[i]) for i in range(4)},
            **{f"command_{i}_Pa": float(command_Pa[i]) for i in range(4)},
            "roll_rad": posture.roll_rad,
            "com_x_m": float(motion.centre_of_mass_m[0]),
            "com_y_m": float(motion.centre_of_mass_m[1]),
            "com_z_m": float(motion.centre_of_mass_m[2]),
            "bend_rad": posture.bend_rad,
            "bend_direction_rad": posture.bend_direction_rad,
            "length_m": posture.length_m,
            "theta_rad": wrapped(active_rad - posture.bend_direction_rad),
            "state": state,
            "c_bend_side": posture.c_bend_side,
            "plane_rotation_rad": posture.plane_rotation_rad,
            "angular_momentum_kg_m2_s": float(np.linalg.norm(motion.angular_momentum_kg_m2_s)),
            "supply_Pa": float(pressure_Pa[4]),
        }
        if self._writer is None:
            self._rows.append(row)
        else:
            self._writer.add(row)
            if self._samples % SHAPE_EVERY == 0:
                points, axes = twin.shape()
                shape = {"centreline_m": points.ravel(), "director": axes.ravel()}
                self._shapes.add({"t_s": t_s, **shape})
        self._samples += 1
        return posture

    def finish(self, steps: int, sim_time_s: float, outcome: str) -> tuple[dict[str, Any], pa.Table]:
        """Close the files and write the summary; returns it with the telemetry."""
        if self._writer is not None and self._run_dir is not None:
            self._shapes.close()
            self._writer.close()
            telemetry = read_telemetry(self._run_dir)
        else:
            telemetry = pa.Table.from_pylist(self._rows, schema=TELEMETRY_SCHEMA)
        cost = Cost(steps, sim_time_s, self._wall_s)
        summary = summarise(self._scene, telemetry, self.events, cost, outcome)
        if self._run_dir is not None:
            write_summary(self._run_dir, summary)
        return summary, telemetry


def samples_of(scene: Scene) -> int:
    """Control periods in a scene."""
    return max(1, round(scene.solver.duration_s / CONTROL_PERIOD_S))


def active_side_rad(pressure_Pa: FloatArray) -> float:
    """Body angle of the pressurised side: of the sum of the chambers' positions weighted by their pressures [rad]."""
    if not np.isfinite(pressure_Pa).all():
        return math.nan
    angles = np.array(CHAMBER_ANGLES_RAD)
    return math.atan2(float(pressure_Pa @ np.sin(angles)), float(pressure_Pa @ np.cos(angles)))
