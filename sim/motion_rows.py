"""Rows of motion: many instants of a robot as one array, a row each, for what runs without leaving compiled code.

The columns carry what `sim.body.Motion` carries, and what the metrics of a rod need beside it. World axes unless the
name says body; SI.
"""

from __future__ import annotations

TIME = 0
POSITION = slice(1, 4)
"""Of the middle."""
ROTATION = slice(4, 13)
"""Mid cross-section, row by row; its columns are e1, e2, t."""
ANGULAR_VELOCITY = slice(13, 16)
"""Of the mid cross-section."""
VELOCITY = slice(16, 19)
"""Of the middle."""
CENTRE_OF_MASS = slice(19, 22)
STRETCH = 22
CURVATURE = slice(23, 25)
"""Mean curvature vector, body frame [1/m]."""
CHORD = slice(25, 28)
"""Unit vector from the first end to the last."""
ANGULAR_MOMENTUM = slice(28, 31)
"""About the centre of mass."""
ENERGY = 31
"""Kinetic + elastic + gravitational [J]."""
WORK = 32
"""Of the actuators since the start [J]: what changing the rest strains has put in."""
PENETRATION = 33
"""Deepest of the contact points in the ground [m]."""
SHARPEST_CURVATURE = 34
"""Greatest curvature along the tube [1/m]."""
ASLEEP = 35
"""1 while the robot sleeps."""
ROW_SIZE = 36
