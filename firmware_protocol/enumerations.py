"""The DBC's value tables as enumerations, so that code reads in names and type checkers see them.

The DBC is the source; a test holds every member here equal to its table there.
"""

from __future__ import annotations

from enum import IntEnum


class ControlMode(IntEnum):
    """SequencerControl.Mode."""

    DISARM = 0
    ARM_REQUEST = 1
    ARM_CONFIRM = 2
    RUN = 3


class BoardMode(IntEnum):
    """BoardHeartbeat.BoardMode and BoardValves.BoardMode."""

    SAFE_LATCHED = 0
    DISARMED = 1
    ARMING = 2
    ARMED = 3


class SafeReason(IntEnum):
    """BoardHeartbeat.SafeReason and BoardFault.Reason: why the board latched its safe state."""

    NONE = 0
    POWER_UP = 1
    COMMAND_TIMEOUT = 2
    HEARTBEAT_TIMEOUT = 3
    PROTECTION_ERROR = 4
    OVER_PRESSURE = 5
    EMERGENCY_STOP = 6
    VERSION_MISMATCH = 7
    ARMING_REFUSED = 8
    ARMING_TIMEOUT = 9
    UNEXPECTED_MODE = 10
    SEQUENCER_FAILED = 11
    SENSOR_INVALID = 12
    BUS_OFF = 13
    INTERNAL_ERROR = 14
    CLOCK_ERROR = 15


class SequencerState(IntEnum):
    """SequencerHeartbeat.State."""

    DISARMED = 0
    PRIMING = 1
    ROLLING = 2
    STALLED = 3
    REVERSING = 4
    DEGRADED = 5
    SAFE = 6


class Health(IntEnum):
    """SequencerHeartbeat.Health and BoardHeartbeat.Health."""

    OK = 0
    WARNING = 1
    DEGRADED = 2
    FAILED = 3


class BusState(IntEnum):
    """BoardErrors.BusState and SequencerErrors.BusState: fault confinement of ISO 11898-1."""

    ERROR_ACTIVE = 0
    ERROR_PASSIVE = 1
    BUS_OFF = 2


class ParameterOperation(IntEnum):
    """ParameterRequest.Operation."""

    READ = 0
    WRITE = 1


class Parameter(IntEnum):
    """ParameterRequest.Parameter; units in `parameters`."""

    MAX_SETPOINT = 1
    OVER_PRESSURE = 2
    COMMAND_TIMEOUT = 3
    HEARTBEAT_TIMEOUT = 4
    ARMING_TIMEOUT = 5
    MAX_COUNTER_DELTA = 6
    TOLERATED_ERRORS = 7
    WINDOW_FRAMES = 16
    SETPOINTS_CLAMPED = 17
    LATCHES = 18


class AbortCode(IntEnum):
    """ParameterResponse.AbortCode."""

    DONE = 0
    UNKNOWN_PARAMETER = 1
    READ_ONLY = 2
    WOULD_RAISE = 3
    TOO_LOW = 4
    CONTRADICTS = 5
    WRONG_MODE = 6


class EmergencyReason(IntEnum):
    """EmergencyStop.Reason."""

    OPERATOR = 0
    INTERNAL_ERROR = 1
    FAULT_DETECTED = 2
    SUPERVISOR = 3
    OTHER = 15


class FaultKind(IntEnum):
    """SequencerFault.Kind."""

    NONE = 0
    RUPTURE = 1
    LEAK = 2
    BLOCKED_INLET = 3
    STUCK_OPEN = 4
    STUCK_CLOSED = 5
    SENSOR_OFFSET = 6
    SENSOR_STUCK = 7
    BLOCKED_EXHAUST = 8
    KINKED_LINE = 9
    VALVE_SLOW = 10
    SUPPLY_SAG = 11
    SUPPLY_LOSS = 12
    SENSOR_DRIFT = 13
    SENSOR_NOISE = 14
    SENSOR_DROPOUT = 15
    SENSOR_SCALE = 16
    LINES_SWAPPED = 17
    IMU_BIAS = 18
    IMU_STUCK = 19
    IMU_DROPOUT = 20
    WALL_SOFTENING = 21
    BALLOONING = 22
    FRICTION_LOST = 23
    OBSTACLE = 24
    UNKNOWN = 255

    @classmethod
    def of_name(cls, name: str) -> FaultKind:
        """The kind with this lower-case name (`rupture`), `UNKNOWN` for a name the table does not have."""
        return cls.__members__.get(name.upper(), cls.UNKNOWN)


NO_CHAMBER = 15
"""Chamber signals carry this where no single chamber is concerned."""
