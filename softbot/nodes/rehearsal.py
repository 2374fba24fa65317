"""A node played through in memory before its loop meets a bus: imports, compilers and caches are done with by then.

The first control cycle of a process is a hundred times as long as the others (modules, just-in-time compiler, caches of
the memory allocator). On a live bus that is a board that vents. So each end is first run through arming and a moment of
control, as fast as it goes, against a stand-in that is no more than a counterpart in frames. Nothing of it is kept.
"""

from __future__ import annotations

from controllers.pressure_loop import PressureLoopGains
from controllers.sequencer import Sequencer
from controllers.sequencer_parts import SequencerConfig
from firmware_protocol.board import BoardRules
from firmware_protocol.frame import Frame
from firmware_protocol.sequencer_link import SequencerLink
from sim.recorder import Recorder
from sim.scene import CONTROL_PERIOD_S, Scene
from sim.twins import make_twin
from softbot.faults import CHAMBER_COUNT
from softbot.nodes.deciding_board import DecidingBoard
from softbot.nodes.plant_node import PlantNode, board_limits
from softbot.nodes.sequencer_node import SequencerNode, sequencer_tuning

REHEARSAL_S = 0.5
_TIMES_S = [round(cycle * CONTROL_PERIOD_S, 6) for cycle in range(round(REHEARSAL_S / CONTROL_PERIOD_S))]
_GRAVITY_M_S2 = 9.81
_LOW_SHARE = 0.2


def rehearse_plant(
    scene: Scene, gains: PressureLoopGains | None = None, board: DecidingBoard = DecidingBoard.PYTHON
) -> None:
    """Board, pressure loop and a throw-away robot, armed and given low pressures. Raises what a plant raises."""
    twin = make_twin(scene)
    try:
        node = PlantNode(scene, twin, Recorder(scene, None), gains, board)
        link = SequencerLink()
        link.arm()
        setpoints_Pa = [_LOW_SHARE * scene.robot.max_pressure_Pa] * CHAMBER_COUNT
        said: list[Frame] = []
        for t_s in _TIMES_S:
            for frame in node.cycle(t_s, said):
                link.receive(frame.frame_id, frame.data, t_s)
            said = link.outgoing(t_s, setpoints_Pa)
            node.advance()
    finally:
        twin.close()


def rehearse_sequencer(scene: Scene) -> None:
    """The scene's sequencer, armed by the board's rules, on readings that never change."""
    at_once = scene.sequencer.model_copy(update={"start_s": 0.0})
    sequencer = Sequencer(SequencerConfig(scene.robot, **sequencer_tuning(at_once)))  # no gains need be designed for it
    node = SequencerNode(scene.model_copy(update={"sequencer": at_once}), sequencer)
    rules = BoardRules(board_limits(scene.robot))
    pressures_Pa = [0.0] * CHAMBER_COUNT
    said: list[Frame] = []
    for t_s in _TIMES_S:
        for frame in said:
            rules.receive(frame.frame_id, frame.data, t_s)
        decision = rules.tick(t_s, pressures_Pa)
        said = node.cycle(
            t_s,
            rules.outgoing(t_s)
            + rules.measurements(
                t_s,
                pressures_Pa=pressures_Pa,
                openings=[0.0] * CHAMBER_COUNT,
                supply_pressure_Pa=scene.robot.pneumatics.supply_pressure_Pa,
                main_supply_open=decision.main_supply_open,
                angular_velocity_rad_s=[0.0, 0.0, 0.0],
                specific_force_m_s2=[0.0, _GRAVITY_M_S2, 0.0],
            ),
        )
