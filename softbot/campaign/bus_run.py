"""One run of a campaign over frames, by the segment twin or a sequencer of one's own: the same row, made the slow way.

Campaigns run the rod twin without a bus (`softbot.nodes.direct`). Here the same scene goes through
`softbot.nodes.lockstep`: either twin, any sequencer that the node takes, a virtual bus or one of python-can's.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from controllers.interface import STATES, Detection, Recovery, SequencerState
from sim.scene import Scene
from softbot.campaign.outcome import Seen, outcome
from softbot.faults import CHAMBER_COUNT
from softbot.nodes.direct import TRACE
from softbot.nodes.lockstep import run_lockstep
from softbot.nodes.plant_node import PlantNode
from softbot.nodes.sequencer_node import ChamberSequencer, SequencerNode
from softbot.robot import Robot

_SAME = {"t_s": "t_s", "x_m": "com_x_m", "y_m": "com_y_m", "supply_Pa": "supply_Pa"} | {
    f"pressure_{i}_Pa": f"pressure_{i}_Pa" for i in range(CHAMBER_COUNT)
}
"""Column of a trace → column of telemetry."""


def bus_row(
    scene: Scene,
    known: Robot | None = None,
    *,
    sequencer: ChamberSequencer | None = None,
    transport: tuple[str, str] | None = None,
) -> dict[str, Any]:
    """Run a scene on a bus: its row (`softbot.campaign.outcome`), of the centre of mass and without heading.

    known: the robot that board and sequencer believe in; sequencer: another one than the scene's; transport: interface
    and channel of the bus. Raises what `run_lockstep` raises.
    """
    states: list[SequencerState] = []

    def watch(plant: PlantNode, own: SequencerNode) -> None:
        states.append(own.state)  # telemetry has what was last heard of it

    result = run_lockstep(scene, sequencer=sequencer, transport=transport, known=known, watch=watch)
    limit_Pa = (known or scene.robot).pneumatics.max_chamber_pressure_Pa
    summary = result.summary
    detections = [
        Detection(float(one["t_s"]), int(one["chamber"]), str(one["kind"]), float(one["confidence"]))
        for one in summary["detections"]
    ]
    recoveries = [Recovery(float(one["t_s"]), str(one["strategy"])) for one in summary["recoveries"]]
    row = outcome(Seen(scene, trace_from(result.telemetry, states), detections, recoveries, limit_Pa))
    return row | {"heading_drift_rad": None}


def trace_from(telemetry: pa.Table, states: list[SequencerState]) -> NDArray[np.float64]:
    """What a trace without a bus would hold of recorded telemetry and states, a row a sample; NaN for the rest."""
    trace = np.full((telemetry.num_rows, len(TRACE)), math.nan)
    for name, column in _SAME.items():
        trace[:, TRACE.index(name)] = telemetry.column(column).to_numpy()
    trace[:, TRACE.index("roll_rad")] = np.unwrap(telemetry.column("roll_rad").to_numpy())
    trace[:, TRACE.index("state")] = [STATES.index(state) for state in states[: len(trace)]]
    return trace
