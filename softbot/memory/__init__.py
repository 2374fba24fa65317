"""Memory of an actuator: what its chambers do with their pressures before the wall's law sees them.

Four parts, each on or off, in the order in which they act on each chamber:

    sensor → line (`line`) → hysteresis (`hysteresis`) → creep (`prony`) → residual (`residual`) → dead band, wall law

Each takes a pressure to the pressure that would have the same effect on a wall without memory, and leaves a pressure
that is held for ever as it is: the wall's law is that of slow loading. `chain.Memory` joins them.
"""
