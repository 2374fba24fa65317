"""The valve board's pressure loop for one robot: nominal volumes, designed gains, the loop, and relief beside it.

Designing the gains takes seconds, so they are kept in the user's cache folder (`XDG_CACHE_HOME`, else `~/.cache`)
under a name made from everything they depend on: pneumatics, volumes, period, and the source of the design itself. A
folder that cannot be read or written costs the time again and nothing else.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from controllers import pressure_loop, pressure_loop_design
from controllers.manifold_relief import relief_memory, relieve_manifold
from controllers.pressure_loop import PressureLoop, PressureLoopGains
from controllers.pressure_loop_design import PressureLoopDesign, analyse_pressure_loop, design_pressure_loop
from sim.scene import CONTROL_PERIOD_S
from softbot import pneumatics
from softbot.errors import InputError
from softbot.faults import CHAMBER_COUNT
from softbot.robot import Robot
from softbot.sensing import Readings

FloatArray = NDArray[np.float64]


class ValveLoop:
    """The pressure loop of one robot as open-loop runs want it (`sim.run.ValveController`), and as a board has it."""

    def __init__(self, robot: Robot, gains: PressureLoopGains | None = None) -> None:
        self._limit_Pa = robot.pneumatics.max_chamber_pressure_Pa
        self._relief = relief_memory(robot.pneumatics.valve_lag_s, CONTROL_PERIOD_S)
        self._loop = PressureLoop(gains or designed_gains(robot), robot.pneumatics, nominal_volumes_m3(robot))

    def openings(self, setpoint_Pa: FloatArray, readings: Readings) -> FloatArray:
        """Valve openings (4,), −1 … +1, for setpoints (4,) [Pa gauge]. One call a control period."""
        return self._loop.step(setpoint_Pa, readings.pressure_Pa, readings.supply_Pa)

    def relieved(self, opening: FloatArray, rests: bool, readings: Readings) -> tuple[FloatArray, bool]:
        """The openings (4,), changed where a chamber fills against its command, and whether one does.

        `controllers.manifold_relief`; rests: the board is in its safe state. One call a control period.
        """
        opening = opening.copy()
        relieves = relieve_manifold(
            self._relief, readings.pressure_Pa, readings.supply_Pa, self._limit_Pa, rests, opening
        )
        return opening, bool(relieves)

    def rest(self, measured_Pa: FloatArray) -> None:
        """Forget the past: the valves were not the loop's, and the pressures (4,) are what they are now."""
        self._loop.reset(measured_Pa)


def nominal_volumes_m3(robot: Robot) -> FloatArray:
    """Effective volume of each chamber at half its limit, shape (4,) [m³], dead volume not counted.

    A chamber that grows with its own pressure takes gas like one of the volume V + p_absolute dV/dp.
    """
    law, half_Pa = robot.actuator_law(), 0.5 * robot.max_pressure_Pa
    absolute_Pa = half_Pa + robot.pneumatics.atmospheric_pressure_absolute_Pa
    volumes = np.empty(CHAMBER_COUNT)
    for chamber in range(CHAMBER_COUNT):
        pressure = np.zeros(CHAMBER_COUNT)
        pressure[chamber] = half_Pa
        rest = law.equilibrium(pressure)
        volume = law.chamber_volumes_m3(robot.length_m, rest.stretch, rest.curvature_1_m)[chamber]
        growth = robot.length_m * float(law.load_matrix[:, chamber] @ rest.jacobian[:, chamber])
        volumes[chamber] = volume + absolute_Pa * growth
    return volumes


def design(robot: Robot) -> PressureLoopDesign:
    """The pressure loop of a robot with its margins, designed anew (seconds).

    For the mean chamber: the design spans 0.8 to 1.6 times its volume, more than chambers differ among themselves.
    """
    return design_pressure_loop(robot.pneumatics, float(nominal_volumes_m3(robot).mean()), CONTROL_PERIOD_S)


def half_open(robot: Robot, gains: PressureLoopGains) -> PressureLoopDesign:
    """The same loop where valves stand half open at any pressure, as a large leak holds them."""
    return analyse_pressure_loop(robot.pneumatics, float(nominal_volumes_m3(robot).mean()), gains)


def designed_gains(robot: Robot) -> PressureLoopGains:
    """The gains of a robot's pressure loop, from the cache where they are known."""
    path = cache_folder() / f"pressure-loop-{_fingerprint(robot)}.json"
    gains = _read(path)
    if gains is None:
        gains = _rounded(design(robot).gains)
        _write(path, gains)
    return gains


def cache_folder() -> Path:
    """Where what was computed once is kept."""
    home = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(home) if os.path.isabs(home) else Path.home() / ".cache") / "softbot"


def _fingerprint(robot: Robot) -> str:
    known = {
        "pneumatics": asdict(robot.pneumatics),
        "volumes_m3": nominal_volumes_m3(robot).tolist(),
        "period_s": CONTROL_PERIOD_S,
    }
    digest = hashlib.sha256(json.dumps(known, sort_keys=True).encode())
    for source in (pressure_loop.__file__, pressure_loop_design.__file__, pneumatics.__file__, __file__):
        digest.update(Path(str(source)).read_bytes())
    return digest.hexdigest()[:24]


def _rounded(gains: PressureLoopGains) -> PressureLoopGains:
    """To four digits: the last bits of a search differ between machines, and runs must not."""
    return replace(
        gains,
        proportional_1_s=float(f"{gains.proportional_1_s:.4g}"),
        integral_1_s2=float(f"{gains.integral_1_s2:.4g}"),
    )


def _read(path: Path) -> PressureLoopGains | None:
    try:
        return PressureLoopGains(**json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError, InputError):
        return None


def _write(path: Path, gains: PressureLoopGains) -> None:
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(json.dumps(asdict(gains)), encoding="utf-8")
        os.replace(partial, path)
    except OSError:
        with contextlib.suppress(OSError):
            partial.unlink()
