"""The document of the protocol is what the DBC says."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

import firmware_protocol.document
from firmware_protocol.document import document
from firmware_protocol.errors import SpecError
from firmware_protocol.spec import dbc_text, read_spec, spec

PAGE = Path(__file__).parents[2] / "docs" / "protocol.md"


def test_the_page_is_made_from_the_dbc() -> None:
    assert document() == PAGE.read_text(encoding="utf-8"), "make it anew: python -m firmware_protocol.document"


def test_the_command_prints_the_page(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(firmware_protocol.document.__file__), run_name="__main__")
    assert capsys.readouterr().out == document()


def test_the_document_names_every_message_signal_and_value() -> None:
    text = document()
    for message in spec().messages:
        assert f"### {message.name}\n" in text
        assert message.comment in text
        for signal in message.signals:
            assert f"| {signal.start}–{signal.start + signal.length - 1} | {signal.name} |" in text
            for raw, label in signal.choices.items():
                assert f"{raw} {label}" in text


def test_the_document_follows_another_dbc() -> None:
    changed = dbc_text().replace('BA_ "GenMsgCycleTime" BO_ 272 10', 'BA_ "GenMsgCycleTime" BO_ 272 25')
    text = document(read_spec(changed))
    assert "| 0x110 | [SequencerSetpoints](#sequencersetpoints) | Sequencer | 8 | every 25 ms |" in text


def test_a_dbc_without_a_comment_on_the_whole_is_refused() -> None:
    with pytest.raises(SpecError, match="comment on the whole is missing"):
        read_spec(dbc_text().replace('CM_ "Protocol between', 'CM_ BU_ Board "Protocol between'))
