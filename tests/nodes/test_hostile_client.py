"""A client that speaks the protocol perfectly and means harm: the gas in the real chambers stays under the limit."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import pytest

from controllers.manifold_relief import BEFOREHAND
from controllers.pressure_loop import PressureLoopGains
from firmware_protocol.e2e import Sender
from firmware_protocol.enumerations import AbortCode, BoardMode, ControlMode, Parameter, SafeReason
from firmware_protocol.frame import Frame
from firmware_protocol.sequencer_link import SequencerLink
from sim.recorder import Recorder
from sim.scene import CONTROL_PERIOD_S, Scene
from sim.twins import make_twin
from softbot.nodes.deciding_board import DecidingBoard
from softbot.nodes.plant_node import PlantNode

MakeScene = Callable[..., Scene]
HIGHEST_ON_THE_BUS_Pa = 819.1e3
LOOP_OVERSHOOT = 1.05


class Attack:
    """A plant node, and a client whose setpoints are a function of time and chamber."""

    def __init__(self, scene: Scene, gains: PressureLoopGains, board: DecidingBoard = DecidingBoard.PYTHON) -> None:
        self.twin = make_twin(scene)
        self.node = PlantNode(scene, self.twin, Recorder(scene, None), gains, board)
        self.link = SequencerLink()
        self.link.arm()
        self.highest_Pa = 0.0
        self.armed_cycles = 0
        self.extra: list[Frame] = []
        self._cycle = 0
        self._said: list[Frame] = []

    def run(self, duration_s: float, wanted_Pa: Callable[[float, int], float]) -> None:
        for _ in range(round(duration_s / CONTROL_PERIOD_S)):
            t_s = self._cycle * CONTROL_PERIOD_S
            self._cycle += 1
            for frame in self.node.cycle(t_s, [*self.extra, *self._said]):
                self.link.receive(frame.frame_id, frame.data, t_s)
            self.extra = []
            self.armed_cycles += not self.node.rules.state.safe
            self._said = self.link.outgoing(t_s, [wanted_Pa(t_s, chamber) for chamber in range(4)])
            self.node.advance()
            self.highest_Pa = max(self.highest_Pa, float(self.node.plant.pressure_Pa[:4].max()))


@pytest.fixture(params=list(DecidingBoard))
def attack(make_scene: MakeScene, gains: PressureLoopGains, request: pytest.FixtureRequest) -> Iterator[Attack]:
    made = Attack(make_scene(), gains, request.param)
    yield made
    made.twin.close()


def square(period_s: float, phase: float) -> Callable[[float, int], float]:
    """All or nothing, each chamber `phase` of a period after the one before."""
    return lambda t_s, chamber: HIGHEST_ON_THE_BUS_Pa if (t_s / period_s - phase * chamber) % 1.0 < 0.5 else 0.0


@pytest.mark.parametrize(
    ("name", "wanted_Pa"),
    [
        ("everything, always", lambda t_s, chamber: HIGHEST_ON_THE_BUS_Pa),
        ("one chamber with the whole supply", lambda t_s, chamber: HIGHEST_ON_THE_BUS_Pa if chamber == 2 else 0.0),
        ("as fast as the bus", square(2 * CONTROL_PERIOD_S, 0.5)),
        ("as fast as the valves", square(0.08, 0.25)),
        ("as fast as the chambers", square(0.3, 0.25)),
        ("all at once", square(0.5, 0.0)),
        ("faster and faster", lambda t_s, chamber: 409.55e3 * (1 + math.sin(20.0 * t_s * t_s + chamber))),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_no_setpoints_bring_a_chamber_above_the_boards_limit(
    attack: Attack, name: str, wanted_Pa: Callable[[float, int], float]
) -> None:
    attack.run(1.6, wanted_Pa)
    limits = attack.node.rules.limits
    print(f"{name}: {1e-3 * attack.highest_Pa:.1f} kPa at most, limit {1e-3 * limits.over_pressure_Pa:.0f} kPa")
    assert attack.armed_cycles > 100
    assert attack.highest_Pa < limits.over_pressure_Pa
    assert attack.highest_Pa < LOOP_OVERSHOOT * limits.max_setpoint_Pa
    assert attack.node.rules.parameters.values[Parameter.SETPOINTS_CLAMPED] > 0


@pytest.mark.parametrize("armed", [False, True])
def test_no_request_raises_a_limit_armed_or_not(attack: Attack, armed: bool) -> None:
    if not armed:
        attack.link.disarm()
    attack.run(0.5, square(0.3, 0.25))
    assert attack.link.armed == armed
    before = dict(attack.node.rules.parameters.values)
    writes = [(each, value) for each in Parameter for value in (before[each] + 1, 0xFFFFFFFF)] + [(0, 1), (200, 1)]
    for parameter, value in writes:
        attack.link.parameters.write(parameter, value)
    attack.run(0.03 * len(writes), lambda t_s, chamber: HIGHEST_ON_THE_BUS_Pa)
    outcomes = list(attack.link.parameters.outcomes)
    assert len(outcomes) == len(writes)
    assert all(each.abort_code not in (None, AbortCode.DONE) for each in outcomes)
    after = attack.node.rules.parameters.values
    assert all(after[each] == before[each] for each in Parameter if each < Parameter.SETPOINTS_CLAMPED)
    assert attack.highest_Pa < attack.node.rules.limits.over_pressure_Pa


def test_a_second_client_that_floods_the_board_only_vents_it(attack: Attack) -> None:
    attack.run(0.8, square(0.5, 0.0))
    assert attack.node.rules.state.mode is BoardMode.ARMED
    second = Sender()
    full = {f"Setpoint{chamber}": 819.1 for chamber in range(4)}
    for _ in range(20):
        attack.extra = [second.send("SequencerSetpoints", full) for _ in range(50)]
        attack.extra += [
            second.send("SequencerControl", {"Mode": mode, "ArmToken": 0, "DbcHash": 0})
            for mode in (ControlMode.RUN, ControlMode.ARM_REQUEST)
        ]
        attack.run(CONTROL_PERIOD_S, square(0.5, 0.0))
    assert attack.node.rules.state.mode is not BoardMode.ARMED
    assert attack.highest_Pa < attack.node.rules.limits.over_pressure_Pa
    attack.run(0.5, square(0.5, 0.0))
    assert float(attack.node.plant.pressure_Pa[:4].max()) < 5e3


STUCK = '[{t_s = 0.9, chamber = 1, kind = "stuck_open", severity = 1.0}]'


def test_a_supply_valve_that_sticks_open_gets_no_more_than_the_manifold_holds(
    make_scene: MakeScene, gains: PressureLoopGains
) -> None:
    """All chambers full and nobody who names faults: the board shuts the main supply at its limit (docs/safety.md)."""
    attack = Attack(make_scene(f"fault={STUCK}"), gains)
    attack.run(1.2, lambda t_s, chamber: HIGHEST_ON_THE_BUS_Pa)
    print(f"stuck open, all full: {1e-3 * attack.highest_Pa:.1f} kPa at most")
    assert SafeReason.OVER_PRESSURE in [each.reason for each in attack.node.rules.transitions]
    assert attack.node.rules.state.safe
    # 100 ml at 250 kPa shared with a chamber that holds 150 kPa in 45 to 60 ml: about 215 kPa, and the gas that came in
    # until the valve was shut. The others have to be vented before they can take any of it.
    assert attack.highest_Pa < 200e3
    attack.run(3.0, lambda t_s, chamber: 0.0)
    attack.twin.close()
    assert attack.node.plant.pressure_Pa.max() < 0.15 * attack.node.rules.limits.over_pressure_Pa  # manifold and all


def test_a_supply_valve_that_sticks_open_is_relieved_through_the_other_chambers(
    make_scene: MakeScene, gains: PressureLoopGains
) -> None:
    """Disarmed as soon as a sequencer would have named it, with 90 kPa in the chamber and nothing in the others."""
    attack = Attack(make_scene(f"fault={STUCK}"), gains)
    attack.run(0.97, lambda t_s, chamber: 90e3 if chamber == 1 else 0.0)
    assert attack.node.plant.pressure_Pa[1] > 100e3
    attack.link.disarm()
    attack.run(2.5, lambda t_s, chamber: 0.0)
    attack.twin.close()
    limit_Pa = attack.node.rules.limits.over_pressure_Pa
    print(f"stuck open, one full: {1e-3 * attack.highest_Pa:.1f} kPa at most")
    assert attack.highest_Pa < limit_Pa
    assert SafeReason.OVER_PRESSURE not in [each.reason for each in attack.node.rules.transitions]
    assert attack.node.plant.pressure_Pa.max() < 0.15 * limit_Pa


def test_where_nobody_disarms_the_main_supply_is_shut_beforehand_for_a_moment_only(
    make_scene: MakeScene, gains: PressureLoopGains
) -> None:
    """What a valve stuck open makes of its chamber within the time that naming it takes."""
    attack = Attack(make_scene(f"fault={STUCK}"), gains)
    attack.run(0.9, lambda t_s, chamber: 90e3 if chamber == 1 else 0.0)
    told, mode = [], []
    for _ in range(16):
        attack.run(CONTROL_PERIOD_S, lambda t_s, chamber: 90e3 if chamber == 1 else 0.0)
        told.append(attack.link.readings.main_supply_open)
        mode.append(attack.node.rules.state.mode)
    attack.run(3.0, lambda t_s, chamber: 0.0)
    attack.twin.close()
    print(f"stuck open, nobody disarms: {1e-3 * attack.highest_Pa:.1f} kPa at most")
    assert attack.highest_Pa < 1.1 * attack.node.rules.limits.over_pressure_Pa
    assert mode == 16 * [BoardMode.ARMED]
    assert told.count(False) == BEFOREHAND
    first = told.index(False)
    assert told[first : first + BEFOREHAND] == BEFOREHAND * [False]
    assert first > 0
