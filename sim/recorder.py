"""Run directory: scene, telemetry, shapes and summary of one run, written as it happens.

What comes in is a block of rows of motion (`sim.motion_rows`), one or many; it leaves as record batches of whole
columns. `record = "summary"` keeps in memory only the columns that the metrics read: no commanded pressures, no
phases, no bend side, no shape.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from sim import motion_rows
from sim.body import Motion, Twin
from sim.scene import CONTROL_PERIOD_S, Scene
from sim.summary import SUMMARY_COLUMNS, Cost, Events, summarise, write_summary
from sim.telemetry import FLUSH_ROWS, NULLABLE, SHAPE_SCHEMA, TELEMETRY_SCHEMA, TableWriter, read_telemetry
from sim.trajectory import Posture, Postures, Trajectory, motion_row, wrapped
from softbot.cross_section import CHAMBER_ANGLES_RAD
from softbot.errors import InputError
from softbot.faults import Fault
from softbot.toml_file import write_toml

FloatArray = NDArray[np.float64]
Record = Literal["all", "summary"]
"""What is kept of a run: every column of the telemetry, or those that the summary is made from."""

SHAPE_PERIOD_S = 0.04
SHAPE_EVERY = round(SHAPE_PERIOD_S / CONTROL_PERIOD_S)  # samples: 25 a second

LEFT_OUT_OF_SUMMARY = (*(name for name in TELEMETRY_SCHEMA.names if name not in SUMMARY_COLUMNS), "shape")
"""What `record = "summary"` does not keep: columns of the telemetry, and the shape."""

_ROWS_IN_MEMORY = 1000  # of a batch there; on disk a batch is what a killed run loses
_NO_PRESSURE = np.full(5, np.nan)


class Recorder:
    """Records one run, into `run_dir` or (None) into memory. Also the run's clock: it times the solver loop alone.

    `sample_s` is the time between samples. Raises InputError when the folder cannot be made, or for a summary alone
    (`record = "summary"`) into a folder, which holds a whole run.
    """

    def __init__(
        self, scene: Scene, run_dir: Path | None, *, record: Record = "all", sample_s: float = CONTROL_PERIOD_S
    ) -> None:
        if run_dir is not None and record != "all":
            raise InputError(f'record = "{record}": a run folder holds the whole run; record into memory instead')
        self._scene, self._run_dir = scene, run_dir
        self._trajectory = Trajectory(scene.robot.length_m, grounded=scene.world.ground != "none")
        self._schema = pa.schema(
            [field for field in TELEMETRY_SCHEMA if record == "all" or field.name in SUMMARY_COLUMNS]
        )
        self._numbers = [name for name in self._schema.names if name != "state"]
        self._batches: list[pa.RecordBatch] = []
        self._batch_rows = _ROWS_IN_MEMORY if run_dir is None else FLUSH_ROWS
        self._start_batch()
        self._samples = 0
        self.sample_s = sample_s
        self._shape_every = max(1, round(SHAPE_PERIOD_S / sample_s))
        self._writer: TableWriter | None = None
        self._shapes: TableWriter | None = None
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
        self.events.faults += [{"t_s": f.t_s, "chamber": f.chamber_number, "kind": str(f.kind)} for f in struck]

    @property
    def shape_every(self) -> int | None:
        """Samples from one shape to the next, the first sample having one; None where no shapes are recorded."""
        return None if self._shapes is None else self._shape_every

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
        if math.isnan(active_rad):
            active_rad = active_side_rad(pressure_Pa[:4])
        if self._samples % self._shape_every == 0:
            self.shape((t_s,), twin)
        return self.block(
            motion_row(motion, t_s)[None],
            pressure_Pa=pressure_Pa,
            command_Pa=command_Pa,
            active_rad=active_rad,
            states=(state,),
        ).last()

    def block(
        self,
        rows: FloatArray,
        *,
        pressure_Pa: FloatArray = _NO_PRESSURE,
        command_Pa: FloatArray = _NO_PRESSURE,
        active_rad: FloatArray | float = math.nan,
        states: Sequence[str],
    ) -> Postures:
        """Record the next samples but for their shapes: rows of motion, shape (n, ROW_SIZE).

        `active_rad`: body angle of the active side, one or n of them; pressures [Pa], shape (5,) or (n, 5) with the
        manifold, and commanded ones, shape (4,) or (n, 4); `states`: n phases.
        """
        postures = self._trajectory.follow_rows(rows)
        columns: dict[str, FloatArray | float] = {
            "t_s": rows[:, motion_rows.TIME],
            **{f"pressure_{i}_Pa": pressure_Pa[..., i] for i in range(4)},
            **{f"command_{i}_Pa": command_Pa[..., i] for i in range(4)},
            **dict(zip(("com_x_m", "com_y_m", "com_z_m"), rows[:, motion_rows.CENTRE_OF_MASS].T, strict=True)),
            **postures._asdict(),
            "theta_rad": wrapped(active_rad - postures.bend_direction_rad),
            "angular_momentum_kg_m2_s": _sizes(rows[:, motion_rows.ANGULAR_MOMENTUM]),
            "supply_Pa": pressure_Pa[..., 4],
            "energy_J": rows[:, motion_rows.ENERGY],
            "work_J": rows[:, motion_rows.WORK],
            "sharpest_curvature_1_m": rows[:, motion_rows.SHARPEST_CURVATURE],
            "penetration_m": rows[:, motion_rows.PENETRATION],
            "asleep": rows[:, motion_rows.ASLEEP],
        }
        self._keep(columns, states)
        self._samples += len(rows)
        return postures

    def shape(self, times_s: Iterable[float], twin: Twin) -> None:
        """The shape that the robot has now and had at all of these times, where shapes are recorded."""
        if self._shapes is not None:
            points, axes = twin.shape()
            for t_s in times_s:
                self._shapes.add({"t_s": t_s, "centreline_m": points.ravel(), "director": axes.ravel()})

    def finish(self, steps: int, sim_time_s: float, outcome: str) -> tuple[dict[str, Any], pa.Table]:
        """Close the files and write the summary; returns it with the telemetry."""
        self._end_batch()
        if self._writer is not None and self._shapes is not None and self._run_dir is not None:
            self._shapes.close()
            self._writer.close()
            telemetry = read_telemetry(self._run_dir)
        else:
            telemetry = pa.Table.from_batches(self._batches, schema=self._schema)
        cost = Cost(steps, sim_time_s, self._wall_s)
        summary = summarise(self._scene, telemetry, self.events, cost, outcome)
        if self._run_dir is not None:
            write_summary(self._run_dir, summary)
        return summary, telemetry

    def _start_batch(self) -> None:
        self._numbers_now = np.empty((len(self._numbers), self._batch_rows))
        self._states_now: list[str] = []
        self._filled = 0

    def _keep(self, columns: Mapping[str, FloatArray | float], states: Sequence[str]) -> None:
        """Into batches of equal size, wherever the blocks are cut. A number stands for a column of itself."""
        taken = 0
        while taken < len(states):
            count = min(len(states) - taken, self._batch_rows - self._filled)
            there, here = slice(self._filled, self._filled + count), slice(taken, taken + count)
            for line, name in zip(self._numbers_now, self._numbers, strict=True):
                column = columns[name]
                line[there] = column[here] if isinstance(column, np.ndarray) and column.ndim else column
            self._states_now += states[here]
            self._filled += count
            taken += count
            if self._filled == self._batch_rows:
                self._end_batch()

    def _end_batch(self) -> None:
        if self._filled == 0:
            return
        numbers = iter(self._numbers_now[:, : self._filled])
        arrays = []
        for name in self._schema.names:
            if name == "state":
                arrays.append(pa.array(self._states_now))
            elif name == "c_bend_side":
                arrays.append(pa.array(next(numbers).astype(np.int8)))
            else:
                arrays.append(pa.array(next(numbers), from_pandas=name in NULLABLE))
        batch = pa.RecordBatch.from_arrays(arrays, schema=self._schema)
        self._start_batch()
        if self._writer is None:
            self._batches.append(batch)
        else:
            self._writer.add_batch(batch)


def samples_of(scene: Scene, sample_s: float = CONTROL_PERIOD_S) -> int:
    """Samples in a scene, `sample_s` apart."""
    return max(1, round(scene.solver.duration_s / sample_s))


def active_side_rad(pressure_Pa: FloatArray) -> float:
    """Body angle of the pressurised side: of the sum of the chambers' positions weighted by their pressures [rad]."""
    if not np.isfinite(pressure_Pa).all():
        return math.nan
    angles = np.array(CHAMBER_ANGLES_RAD)
    return math.atan2(float(pressure_Pa @ np.sin(angles)), float(pressure_Pa @ np.cos(angles)))


def _sizes(vectors: FloatArray) -> FloatArray:
    """Lengths of vectors, shape (n, 3)."""
    return np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
