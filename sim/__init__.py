"""Scenes, twins, sensors, telemetry: pressures and valve openings in, sensor readings out.

Knows nothing of a sequencer or a bus.
"""
