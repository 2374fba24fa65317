"""No frame and no order of frames opens a valve that should be shut."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.board import VENTED
from firmware_protocol.enumerations import BoardMode, ControlMode, Health, SafeReason
from firmware_protocol.frame import Frame

NewBench = Callable[..., Any]


LISTED = {0x010: 2, 0x100: 8, 0x110: 8, 0x120: 6, 0x130: 6}


@given(
    st.lists(
        st.one_of(
            st.tuples(st.integers(0, 2047), st.binary(max_size=8)),
            st.sampled_from(sorted(LISTED)).flatmap(
                lambda frame_id: st.tuples(
                    st.just(frame_id), st.binary(min_size=LISTED[frame_id], max_size=LISTED[frame_id])
                )
            ),
        ),
        max_size=40,
    )
)
@settings(deadline=None, max_examples=60)
def test_random_frames_never_open_a_valve_nor_raise(new_bench: NewBench, frames: list[tuple[int, bytes]]) -> None:
    bench = new_bench().disarmed()
    for frame_id, data in frames:
        bench.put(Frame(frame_id, data))
        assert bench.tick().safe
        assert bench.rules.state.last_error == ""


ACTIONS = st.one_of(
    st.tuples(st.just("control"), st.sampled_from(list(ControlMode)), st.booleans()),
    st.tuples(st.just("setpoints"), st.floats(0, 815), st.just(False)),
    st.tuples(st.just("heartbeat"), st.sampled_from(list(Health)), st.just(False)),
    st.tuples(st.just("stop"), st.just(0), st.just(False)),
    st.tuples(st.just("wait"), st.sampled_from([0.01, 0.05, 0.1, 0.2]), st.just(False)),
    st.tuples(st.just("pressure"), st.sampled_from([0.0, 1e5, 2.6e5, math.nan]), st.just(False)),
)


@given(st.lists(ACTIONS, max_size=60))
@settings(deadline=None, max_examples=150)
def test_valves_open_only_when_armed_and_running_and_only_to_the_limit(
    new_bench: NewBench,
    actions: list[tuple[str, float, bool]],
) -> None:
    bench = new_bench()
    seen_disarmed = False
    for action, value, right_token in actions:
        if action == "control":
            bench.control(int(value), bench.token() if right_token else 0)
        elif action == "setpoints":
            bench.setpoints(value)
        elif action == "heartbeat":
            bench.heartbeat(Health(int(value)))
        elif action == "stop":
            bench.stop()
            assert bench.mode is BoardMode.SAFE_LATCHED
        elif action == "wait":
            bench.t_s = round(bench.t_s + value, 6)
        else:
            bench.measured_Pa = (0.0, value, 0.0, 0.0)
        decision = bench.tick()
        seen_disarmed = seen_disarmed or decision.mode is BoardMode.DISARMED
        assert decision.safe == (not decision.main_supply_open)
        assert (decision.mode is BoardMode.SAFE_LATCHED) == (decision.reason is not SafeReason.NONE)
        if decision.safe:
            assert decision.setpoints_Pa == VENTED
        else:
            assert seen_disarmed
            assert decision.mode is BoardMode.ARMED
            assert bench.rules.state.control_mode is ControlMode.RUN
            assert max(decision.setpoints_Pa) <= bench.rules.limits.max_setpoint_Pa
            assert max(bench.measured_Pa) <= bench.rules.limits.over_pressure_Pa
