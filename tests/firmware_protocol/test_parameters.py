"""Parameters are read and lowered over the bus, and nothing on the bus can raise a limit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.board import BoardLimits
from firmware_protocol.codec import decode
from firmware_protocol.enumerations import AbortCode, BoardMode, ControlMode, Parameter, ParameterOperation, SafeReason
from firmware_protocol.frame import Frame
from firmware_protocol.parameters import HIGHEST_COUNT, PARAMETERS, ParameterAnswer, Parameters
from firmware_protocol.spec import message_spec

NewBench = Callable[..., Any]
LIMITS = BoardLimits(max_setpoint_Pa=200e3, over_pressure_Pa=250e3)
WRITABLE = [each.parameter for each in PARAMETERS if each.minimum is not None]
STARTING = {
    Parameter.MAX_SETPOINT: 2000,
    Parameter.OVER_PRESSURE: 2500,
    Parameter.COMMAND_TIMEOUT: 100,
    Parameter.HEARTBEAT_TIMEOUT: 200,
    Parameter.ARMING_TIMEOUT: 1000,
    Parameter.MAX_COUNTER_DELTA: 3,
    Parameter.TOLERATED_ERRORS: 3,
    Parameter.WINDOW_FRAMES: 16,
    Parameter.SETPOINTS_CLAMPED: 0,
    Parameter.LATCHES: 0,
}


def request(operation: int, parameter: int, value: int = 0, transaction: int = 7) -> dict[str, int]:
    return {"Operation": operation, "Parameter": parameter, "Transaction": transaction, "Value": value}


def write(parameters: Parameters, parameter: int, value: int) -> AbortCode:
    return parameters.execute(request(ParameterOperation.WRITE, parameter, value), may_write=True).abort_code


def ask(bench: Any, operation: int, parameter: int, value: int = 0) -> tuple[int, int]:
    """The answer's abort code and value."""
    bench.put(bench.peer.send("ParameterRequest", request(operation, parameter, value, 200)))
    bench.t_s = round(bench.t_s + 0.02, 6)
    frames = dict(decode(*frame) for frame in bench.rules.outgoing(bench.t_s))
    answer = frames["ParameterResponse"]
    assert (answer["Parameter"], answer["Transaction"]) == (parameter, 200)
    return int(answer["AbortCode"]), int(answer["Value"])


def test_every_parameter_of_the_dbc_is_there_and_can_be_read() -> None:
    parameters = Parameters(LIMITS)
    assert [each.parameter for each in PARAMETERS] == list(Parameter)
    for parameter in Parameter:
        answer = parameters.execute(request(ParameterOperation.READ, parameter, 1), may_write=False)
        assert answer == ParameterAnswer(AbortCode.DONE, parameter, 7, STARTING[parameter])


@pytest.mark.parametrize("parameter", WRITABLE)
def test_a_limit_goes_down_and_not_up_again(parameter: Parameter) -> None:
    parameters = Parameters(LIMITS)
    start = STARTING[parameter]
    assert write(parameters, parameter, start + 1) is AbortCode.WOULD_RAISE
    assert write(parameters, parameter, HIGHEST_COUNT) is AbortCode.WOULD_RAISE
    assert parameters.values[parameter] == start
    assert write(parameters, parameter, start) is AbortCode.DONE
    assert write(parameters, parameter, start - 1) is AbortCode.DONE
    assert parameters.values[parameter] == start - 1
    assert write(parameters, parameter, start) is AbortCode.WOULD_RAISE
    assert parameters.values[parameter] == start - 1
    assert {key: value for key, value in parameters.values.items() if key is not parameter} == {
        key: value for key, value in STARTING.items() if key is not parameter
    }


@pytest.mark.parametrize(
    ("parameter", "minimum"),
    [
        (Parameter.MAX_SETPOINT, 1),
        (Parameter.COMMAND_TIMEOUT, 40),
        (Parameter.HEARTBEAT_TIMEOUT, 100),
        (Parameter.ARMING_TIMEOUT, 200),
        (Parameter.MAX_COUNTER_DELTA, 1),
        (Parameter.TOLERATED_ERRORS, 0),
    ],
)
def test_a_value_the_board_cannot_work_with_is_too_low(parameter: Parameter, minimum: int) -> None:
    parameters = Parameters(LIMITS)
    if minimum > 0:
        assert write(parameters, parameter, minimum - 1) is AbortCode.TOO_LOW
        assert parameters.values[parameter] == STARTING[parameter]
    assert write(parameters, parameter, minimum) is AbortCode.DONE
    assert parameters.values[parameter] == minimum


def test_the_least_timeouts_are_two_cycles_of_what_they_watch() -> None:
    least_ms = {each.parameter: each.minimum for each in PARAMETERS}
    for parameter, watched in (
        (Parameter.COMMAND_TIMEOUT, ("SequencerControl", "SequencerSetpoints")),
        (Parameter.HEARTBEAT_TIMEOUT, ("SequencerHeartbeat",)),
    ):
        cycles_s = [message_spec(name).cycle_s for name in watched]
        assert least_ms[parameter] == 2000 * max(cycles_s)  # type: ignore[type-var]


def test_over_pressure_stays_above_the_highest_setpoint() -> None:
    parameters = Parameters(LIMITS)
    assert write(parameters, Parameter.OVER_PRESSURE, 2000) is AbortCode.CONTRADICTS
    assert write(parameters, Parameter.OVER_PRESSURE, 2001) is AbortCode.DONE
    assert write(parameters, Parameter.MAX_SETPOINT, 1) is AbortCode.DONE
    assert write(parameters, Parameter.OVER_PRESSURE, 1) is AbortCode.TOO_LOW
    assert write(parameters, Parameter.OVER_PRESSURE, 2) is AbortCode.DONE


@pytest.mark.parametrize("parameter", [Parameter.WINDOW_FRAMES, Parameter.SETPOINTS_CLAMPED, Parameter.LATCHES])
def test_what_is_measured_can_only_be_read(parameter: Parameter) -> None:
    assert write(Parameters(LIMITS), parameter, 0) is AbortCode.READ_ONLY


@pytest.mark.parametrize("operation", list(ParameterOperation))
@pytest.mark.parametrize("number", [0, 8, 15, 19, 255])
def test_an_unknown_parameter_is_answered_so(operation: ParameterOperation, number: int) -> None:
    answer = Parameters(LIMITS).execute(request(operation, number, 5), may_write=True)
    assert answer == ParameterAnswer(AbortCode.UNKNOWN_PARAMETER, number, 7, 0)


def test_counts_stay_at_their_highest() -> None:
    parameters = Parameters(LIMITS)
    parameters.values[Parameter.LATCHES] = HIGHEST_COUNT - 1
    parameters.count(Parameter.LATCHES)
    parameters.count(Parameter.LATCHES, 5)
    assert parameters.values[Parameter.LATCHES] == HIGHEST_COUNT == (1 << 32) - 1


@given(st.lists(st.tuples(st.integers(0, 1), st.integers(0, 255), st.integers(0, HIGHEST_COUNT)), max_size=60))
@settings(deadline=None, max_examples=200)
def test_no_order_of_requests_raises_a_limit_or_leaves_them_contradicting(requests: list[tuple[int, int, int]]) -> None:
    parameters = Parameters(LIMITS)
    for operation, number, value in requests:
        before = dict(parameters.values)
        answer = parameters.execute(request(operation, number % 20, value % 2600), may_write=True)
        for known in PARAMETERS:
            assert parameters.values[known.parameter] <= before[known.parameter]
            if known.minimum is not None:
                assert parameters.values[known.parameter] >= known.minimum
        if answer.abort_code is not AbortCode.DONE or operation == ParameterOperation.READ:
            assert parameters.values == before
        assert parameters.values[Parameter.MAX_SETPOINT] < parameters.values[Parameter.OVER_PRESSURE]


# ---------------------------------------------------------------------- on the board


def test_a_lowered_limit_acts_and_holds_through_disarming_until_power_up(new_bench: NewBench) -> None:
    bench = new_bench()
    assert ask(bench, ParameterOperation.WRITE, Parameter.MAX_SETPOINT, 500) == (AbortCode.DONE, 500)
    bench.running()
    assert bench.tick().setpoints_Pa == (50e3, 50e3, 50e3, 50e3)
    bench.control(ControlMode.DISARM)
    bench.stop()
    bench.running()
    assert bench.tick().setpoints_Pa == (50e3, 50e3, 50e3, 50e3)
    assert ask(bench, ParameterOperation.READ, Parameter.SETPOINTS_CLAMPED) == (AbortCode.DONE, 8)
    assert new_bench().running().tick().setpoints_Pa == pytest.approx((100e3, 101e3, 102e3, 103e3))


def test_the_lowered_over_pressure_limit_latches(new_bench: NewBench) -> None:
    bench = new_bench()
    ask(bench, ParameterOperation.WRITE, Parameter.MAX_SETPOINT, 900)
    ask(bench, ParameterOperation.WRITE, Parameter.OVER_PRESSURE, 1000)
    bench.running()
    bench.measured_Pa = (0.0, 0.0, 0.0, 100e3)
    assert not bench.tick().safe
    bench.measured_Pa = (0.0, 0.0, 0.0, 100.01e3)
    bench.assert_latched(SafeReason.OVER_PRESSURE)


@pytest.mark.parametrize(
    ("parameter", "missing", "timeout_s", "reason"),
    [
        (Parameter.COMMAND_TIMEOUT, "SequencerSetpoints", 0.04, SafeReason.COMMAND_TIMEOUT),
        (Parameter.COMMAND_TIMEOUT, "SequencerControl", 0.04, SafeReason.COMMAND_TIMEOUT),
        (Parameter.HEARTBEAT_TIMEOUT, "SequencerHeartbeat", 0.1, SafeReason.HEARTBEAT_TIMEOUT),
    ],
)
def test_a_lowered_timeout_acts(
    new_bench: NewBench, parameter: Parameter, missing: str, timeout_s: float, reason: SafeReason
) -> None:
    bench = new_bench()
    ask(bench, ParameterOperation.WRITE, parameter, round(1000 * timeout_s))
    bench.running()
    bench.wait(0.3)
    assert not bench.wait(timeout_s - 0.01, without=missing).safe
    bench.wait(0.01, without=missing)
    bench.assert_latched(reason)


def test_a_lowered_arming_timeout_acts(new_bench: NewBench) -> None:
    bench = new_bench()
    ask(bench, ParameterOperation.WRITE, Parameter.ARMING_TIMEOUT, 200)
    bench.arming()
    bench.t_s += 0.2
    bench.assert_latched(SafeReason.ARMING_TIMEOUT)


def test_lowered_tolerances_act(new_bench: NewBench) -> None:
    bench = new_bench()
    ask(bench, ParameterOperation.WRITE, Parameter.TOLERATED_ERRORS, 0)
    bench.running()
    bench.put(Frame(0x110, bytes(8)))
    bench.assert_latched(SafeReason.PROTECTION_ERROR)
    bench = new_bench()
    ask(bench, ParameterOperation.WRITE, Parameter.MAX_COUNTER_DELTA, 1)
    bench.running()
    bench.peer.counters["SequencerSetpoints"] += 1
    assert not bench.setpoints().accepted
    assert bench.setpoints().accepted


@pytest.mark.parametrize("stage", ["arming", "armed", "running"])
def test_nothing_is_written_while_armed_but_everything_can_be_read(new_bench: NewBench, stage: str) -> None:
    bench = getattr(new_bench(), stage)()
    for parameter in WRITABLE:
        bench.heartbeat()
        bench.control(ControlMode.RUN if stage == "running" else ControlMode.ARM_CONFIRM, bench.token())
        bench.setpoints()
        low = STARTING[parameter] - 1
        assert ask(bench, ParameterOperation.WRITE, parameter, low) == (AbortCode.WRONG_MODE, STARTING[parameter])
    assert bench.rules.state.mode is BoardMode.ARMED


def test_latches_are_counted(new_bench: NewBench) -> None:
    bench = new_bench()
    for _ in range(3):
        bench.disarmed().stop()
    assert ask(bench, ParameterOperation.READ, Parameter.LATCHES) == (AbortCode.DONE, 3)


def test_answers_keep_their_gap_and_the_last_request_is_answered(new_bench: NewBench) -> None:
    bench = new_bench()
    ask(bench, ParameterOperation.READ, Parameter.LATCHES)
    for parameter in (Parameter.MAX_SETPOINT, Parameter.OVER_PRESSURE):
        bench.put(bench.peer.send("ParameterRequest", request(ParameterOperation.READ, parameter)))
    assert "ParameterResponse" not in dict(decode(*frame) for frame in bench.rules.outgoing(bench.t_s + 0.019))
    answer = dict(decode(*frame) for frame in bench.rules.outgoing(bench.t_s + 0.02))["ParameterResponse"]
    assert answer["Parameter"] == Parameter.OVER_PRESSURE
    assert "ParameterResponse" not in dict(decode(*frame) for frame in bench.rules.outgoing(bench.t_s + 0.5))
