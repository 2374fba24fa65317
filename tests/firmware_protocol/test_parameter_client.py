"""The sequencer's end asks one thing at a time, repeats it, and gives up at last."""

from __future__ import annotations

from typing import Any

import pytest

from firmware_protocol.enumerations import AbortCode, Parameter, ParameterOperation
from firmware_protocol.errors import FrameError
from firmware_protocol.parameter_client import ParameterClient, ParameterOutcome


def answer(request: dict[str, float] | None, abort_code: AbortCode = AbortCode.DONE, value: int = 5) -> dict[str, Any]:
    assert request is not None
    return {
        "AbortCode": int(abort_code),
        "Parameter": int(request["Parameter"]),
        "Transaction": int(request["Transaction"]),
        "Value": value,
    }


def test_requests_go_out_one_after_the_other_with_their_gap() -> None:
    client = ParameterClient()
    assert client.due(0) is None
    client.read(Parameter.LATCHES)
    client.write(Parameter.MAX_SETPOINT, 900)
    first = client.due(0)
    assert first == {"Operation": ParameterOperation.READ, "Parameter": 18, "Transaction": 1, "Value": 0}
    assert client.due(5_000) is None
    client.take(answer(first))
    assert client.due(19_999) is None
    second = client.due(20_000)
    assert second == {"Operation": ParameterOperation.WRITE, "Parameter": 1, "Transaction": 2, "Value": 900}
    client.take(answer(second, AbortCode.WOULD_RAISE, 800))
    assert client.due(1_000_000) is None
    assert list(client.outcomes) == [
        ParameterOutcome(Parameter.LATCHES, AbortCode.DONE, 5),
        ParameterOutcome(Parameter.MAX_SETPOINT, AbortCode.WOULD_RAISE, 800),
    ]
    assert client.values == {Parameter.LATCHES: 5, Parameter.MAX_SETPOINT: 800}


def test_what_is_not_answered_is_repeated_twice_and_then_given_up() -> None:
    client = ParameterClient()
    client.read(Parameter.LATCHES)
    client.read(Parameter.WINDOW_FRAMES)
    sent = [(t_us, client.due(t_us)) for t_us in range(0, 400_000, 10_000)]
    times = [(t_us, request["Parameter"], request["Transaction"]) for t_us, request in sent if request is not None]
    assert times == [(0, 18, 1), (100_000, 18, 1), (200_000, 18, 1), (300_000, 16, 2)]
    assert list(client.outcomes) == [ParameterOutcome(Parameter.LATCHES, None, None)]


def test_answers_to_something_else_are_let_pass() -> None:
    client = ParameterClient()
    client.take({"AbortCode": 0, "Parameter": 18, "Transaction": 0, "Value": 0})
    client.read(Parameter.LATCHES)
    request = client.due(0)
    client.take(answer(request) | {"Transaction": 2})
    client.take(answer(request) | {"Parameter": 17})
    assert not client.outcomes
    client.take(answer(request))
    client.take(answer(request))
    assert len(client.outcomes) == 1


def test_an_unknown_parameter_has_no_value() -> None:
    client = ParameterClient()
    client.read(99)
    client.take(answer(client.due(0), AbortCode.UNKNOWN_PARAMETER, 0))
    assert list(client.outcomes) == [ParameterOutcome(99, AbortCode.UNKNOWN_PARAMETER, 0)]
    assert client.values == {}


def test_transactions_count_modulo_256() -> None:
    client = ParameterClient()
    for count in range(1, 258):
        client.read(Parameter.LATCHES)
        request = client.due(count * 1_000_000)
        assert request is not None
        assert request["Transaction"] == count % 256
        client.take(answer(request))


@pytest.mark.parametrize(("parameter", "value"), [(256, 0), (-1, 0), (1, -1), (1, 1 << 32), (1, 0.5)])
def test_what_no_frame_can_carry_is_refused_when_asked(parameter: int, value: int) -> None:
    with pytest.raises(FrameError, match="ParameterRequest"):
        ParameterClient().write(parameter, value)


def test_a_clock_that_went_back_does_not_stop_the_requests() -> None:
    client = ParameterClient()
    client.read(Parameter.LATCHES)
    client.due(10_000_000)
    client.restart(0)
    assert client.due(99_999) is None
    assert client.due(100_000) is not None
    client.restart(150_000)
    assert client.due(199_999) is None
    assert client.due(200_000) is not None
