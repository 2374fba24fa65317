"""Each end takes the identifiers, lengths and direction of its list and refuses all the rest of the id space."""

from __future__ import annotations

import random

import pytest

from firmware_protocol.board import BoardLimits, BoardRules
from firmware_protocol.e2e import FrameStatus
from firmware_protocol.enumerations import BoardMode
from firmware_protocol.reception import Reception
from firmware_protocol.sequencer_link import LinkState, SequencerLink
from firmware_protocol.spec import BOARD, SEQUENCER, spec

LISTED = {
    BOARD: {0x010: 2, 0x100: 8, 0x110: 8, 0x120: 6, 0x130: 6, 0x140: 8, 0x150: 6, 0x160: 8},
    SEQUENCER: {
        0x200: 8,
        0x210: 8,
        0x220: 6,
        0x230: 8,
        0x231: 8,
        0x240: 5,
        0x250: 8,
        0x260: 8,
        0x270: 8,
        0x280: 8,
        0x290: 8,
    },
}
IDENTIFIERS = 2048
LENGTHS = range(9)


@pytest.mark.parametrize("node", [BOARD, SEQUENCER])
def test_the_list_is_what_is_written_here_and_nothing_sends_to_itself(node: str) -> None:
    assert {each.frame_id: each.length_bytes for each in spec().messages if node in each.receivers} == LISTED[node]
    assert all(each.sender != node for each in spec().messages if node in each.receivers)


@pytest.mark.parametrize("node", [BOARD, SEQUENCER])
def test_every_identifier_and_length_that_is_not_listed_is_refused(node: str) -> None:
    reception = Reception(node)
    listed = LISTED[node]
    rng = random.Random(node)
    refused = unknown = 0
    for frame_id in range(IDENTIFIERS):
        for length in LENGTHS:
            if listed.get(frame_id) == length:
                continue
            for data in (bytes(length), b"\xff" * length, rng.randbytes(length)):
                received = reception.accept(frame_id, data, 0)
                assert received.status is (FrameStatus.MALFORMED if frame_id in listed else FrameStatus.NOT_LISTED)
                assert received.raw == {}
                assert received.name == (spec().by_id[frame_id].name if frame_id in listed else None)
            refused += 1
            unknown += frame_id not in listed
    print(f"{node}: {refused} identifiers x lengths refused")
    assert refused == IDENTIFIERS * len(LENGTHS) - len(listed)
    assert reception.not_listed == 3 * unknown
    assert reception.refused_frames == 3 * refused
    assert reception.protection_errors == 0


def test_the_whole_id_space_moves_neither_a_disarmed_board_nor_an_idle_link() -> None:
    board = BoardRules(BoardLimits(200e3, 250e3))
    link = SequencerLink()
    rng = random.Random(5)
    for frame_id in range(IDENTIFIERS):
        for length in LENGTHS:
            data = rng.randbytes(length)
            if LISTED[BOARD].get(frame_id) != length:
                board.receive(frame_id, data, 0.0)
            if LISTED[SEQUENCER].get(frame_id) != length:
                link.receive(frame_id, data, 0.0)
    assert board.tick(0.0, (0.0,) * 4).safe
    assert board.state.mode is BoardMode.SAFE_LATCHED
    assert board.state.last_error == ""
    assert link.state is LinkState.DISARMED
    assert link.readings.pressures_Pa is None
