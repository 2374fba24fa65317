"""The DBC says everything both ends need, and a DBC that does not is refused."""

from __future__ import annotations

import math
import re
import subprocess
import sys

import pytest

from firmware_protocol import enumerations
from firmware_protocol.errors import FrameError, ProtocolError, SpecError
from firmware_protocol.spec import (
    SignalKind,
    dbc_hash,
    dbc_text,
    hash_of_dbc,
    message_spec,
    read_spec,
    spec,
    time_us,
)

IDENTIFIERS = {
    "EmergencyStop": 0x010,
    "SequencerControl": 0x100,
    "SequencerSetpoints": 0x110,
    "SequencerHeartbeat": 0x120,
    "SequencerFault": 0x130,
    "ParameterRequest": 0x140,
    "TimeSyncRequest": 0x150,
    "SequencerErrors": 0x160,
    "BoardPressures": 0x200,
    "BoardValves": 0x210,
    "BoardSupply": 0x220,
    "ImuGyro": 0x230,
    "ImuAccelerometer": 0x231,
    "BoardFault": 0x240,
    "BoardHeartbeat": 0x250,
    "BoardBoot": 0x260,
    "ParameterResponse": 0x270,
    "TimeSyncResponse": 0x280,
    "BoardErrors": 0x290,
}
CYCLE_S = {
    "SequencerControl": 0.02,
    "SequencerHeartbeat": 0.05,
    "BoardHeartbeat": 0.05,
    "BoardBoot": 0.2,
    "EmergencyStop": None,
    "SequencerFault": None,
    "BoardFault": None,
    "ParameterRequest": None,
    "ParameterResponse": None,
    "TimeSyncRequest": 0.1,
    "TimeSyncResponse": None,
    "SequencerErrors": 1.0,
    "BoardErrors": 1.0,
}


def test_messages_have_their_identifiers_cycles_and_one_direction() -> None:
    protocol = spec()
    assert {message.name: message.frame_id for message in protocol.messages} == IDENTIFIERS
    assert protocol.bitrate_bit_s == 500_000
    for message in protocol.messages:
        assert message.cycle_s == CYCLE_S.get(message.name, 0.01)
        assert {message.sender} | message.receivers == {"Sequencer", "Board"}
        assert message.length_bytes <= 8


def test_every_message_and_signal_is_documented() -> None:
    for message in spec().messages:
        assert message.comment
        for signal in message.signals:
            assert signal.comment, (message.name, signal.name)
            assert signal.unit, (message.name, signal.name)
            assert signal.minimum < signal.maximum
            # The fields fit their bits exactly or with room that the codec refuses.
            lowest, highest = (
                (-(1 << signal.length - 1), (1 << signal.length - 1) - 1)
                if signal.signed
                else (0, (1 << signal.length) - 1)
            )
            assert lowest <= signal.raw_minimum < signal.raw_maximum <= highest
            if signal.kind is SignalKind.ENUMERATION:
                assert min(signal.choices) == signal.minimum
                assert max(signal.choices) == signal.maximum
            if signal.kind is SignalKind.SATURATED_NUMBER:
                assert signal.choices[signal.raw_maximum] == "at_or_above_maximum"


def test_four_pressures_with_counter_and_crc_fill_eight_bytes() -> None:
    for name, prefix in (("SequencerSetpoints", "Setpoint"), ("BoardPressures", "Pressure")):
        message = message_spec(name)
        assert message.length_bytes == 8
        assert message.reserved_mask == 0
        fields = [signal for signal in message.signals if signal.name.startswith(prefix)]
        assert [(each.length, each.scale, each.unit) for each in fields] == [(13, 0.1, "kPa")] * 4


@pytest.mark.parametrize(
    ("message", "signal", "enumeration"),
    [
        ("EmergencyStop", "Reason", enumerations.EmergencyReason),
        ("SequencerControl", "Mode", enumerations.ControlMode),
        ("SequencerHeartbeat", "State", enumerations.SequencerState),
        ("SequencerHeartbeat", "Health", enumerations.Health),
        ("SequencerFault", "Kind", enumerations.FaultKind),
        ("BoardValves", "BoardMode", enumerations.BoardMode),
        ("BoardHeartbeat", "BoardMode", enumerations.BoardMode),
        ("BoardHeartbeat", "SafeReason", enumerations.SafeReason),
        ("BoardFault", "Reason", enumerations.SafeReason),
        ("BoardHeartbeat", "Health", enumerations.Health),
        ("BoardErrors", "BusState", enumerations.BusState),
        ("SequencerErrors", "BusState", enumerations.BusState),
        ("ParameterRequest", "Operation", enumerations.ParameterOperation),
        ("ParameterRequest", "Parameter", enumerations.Parameter),
        ("ParameterResponse", "Parameter", enumerations.Parameter),
        ("ParameterResponse", "AbortCode", enumerations.AbortCode),
    ],
)
def test_enumerations_are_the_value_tables(message: str, signal: str, enumeration: type) -> None:
    table = next(each for each in message_spec(message).signals if each.name == signal).choices
    assert {member.value: member.name.lower() for member in enumeration} == table  # type: ignore[attr-defined]


def test_fault_kind_of_an_unlisted_name_is_unknown() -> None:
    assert enumerations.FaultKind.of_name("rupture") is enumerations.FaultKind.RUPTURE
    assert enumerations.FaultKind.of_name("meteorite") is enumerations.FaultKind.UNKNOWN


def test_hash_follows_the_content_and_not_the_line_ends() -> None:
    text = dbc_text()
    assert dbc_hash() == hash_of_dbc(text) == hash_of_dbc(text.replace("\n", "\r\n"))
    assert 0 <= dbc_hash() < 1 << 32
    assert hash_of_dbc(text.replace("(0.1,0)", "(0.2,0)", 1)) != dbc_hash()


@pytest.mark.parametrize(
    ("pattern", "replacement", "complaint"),
    [
        ("VERSION.*", "VERSION", "not a valid DBC"),
        ("BO_ 16 EmergencyStop", "BO_ 2147483664 EmergencyStop", "11-bit"),
        ("EmergencyStop: 2 Sequencer", "EmergencyStop: 2 Vector__XXX", "one sender"),  # DBC's name for "no node"
        (r"SG_ Crc : 0\|8", "SG_ Checksum : 0|8", "must begin with Crc"),
        (r"SG_ Reason : 12\|4@1\+", "SG_ Reason : 15|4@0+", "little-endian"),
        (r"\[0\|15\] \"1\" Board\n\nBO_ 256", '[0|0] "1" Board\n\nBO_ 256', "needs a range"),
        ('BA_ "E2EDataIdList" BO_ 16 "03 ', 'BA_ "E2EDataIdList" BO_ 16 "0x ', "not hexadecimal"),
        ('BA_ "E2EDataIdList" BO_ 16 "03 ', 'BA_ "E2EDataIdList" BO_ 16 "', "needs 16 bytes, it has 15"),
        ('BA_ "GenMsgDelayTime" BO_ 16 10;', 'BA_ "GenMsgDelayTime" BO_ 16 0;', "needs GenMsgCycleTime"),
        ('BA_ "Baudrate" 500000;', "", "Baudrate is missing"),
        ("VAL_ 16 Reason .*", "", "needs a value table"),
    ],
)
def test_a_dbc_that_lacks_something_is_refused(pattern: str, replacement: str, complaint: str) -> None:
    text, count = re.subn(pattern, replacement, dbc_text(), count=1)
    assert count == 1
    with pytest.raises(SpecError, match=complaint):
        read_spec(text)


def test_a_signal_without_a_kind_is_a_number() -> None:
    text = re.sub(r'BA_ "SignalKind" SG_ 16 Reason 2;\n', "", dbc_text())
    reason = read_spec(text).by_name["EmergencyStop"].signals[2]
    assert reason.kind is SignalKind.NUMBER


def test_unknown_message_and_bad_times_are_named() -> None:
    with pytest.raises(FrameError, match=r"'Nothing' is no message of softbot\.dbc \(it has EmergencyStop"):
        message_spec("Nothing")
    assert time_us(0.1) == 100_000
    for t_s in (math.nan, math.inf):
        with pytest.raises(ProtocolError, match="not finite"):
            time_us(t_s)


def test_importing_the_package_loads_no_heavy_module() -> None:
    code = (
        "import sys, firmware_protocol.board, firmware_protocol.sequencer_link, firmware_protocol.trace; "
        "print([name for name in ('can', 'cantools', 'numpy', 'softbot') if name in sys.modules])"
    )
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert output.strip() == "[]"
