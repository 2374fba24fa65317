"""softbot: digital twin and controller of a rolling four-chamber pneumatic soft robot.

This package is the robot itself: geometry, material, section mechanics, actuator law, pneumatics, faults.
`softbot.nodes` and `softbot.cli` sit above every other package; nothing below imports them.
"""

__version__ = "0.1.0"
