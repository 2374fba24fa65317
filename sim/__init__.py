"""Scenes, twins, sensors, telemetry: pressures and valve openings in, sensor readings out.

Knows nothing of a sequencer or a bus.
"""

from sim.run_many import run_many

__all__ = ["run_many"]
