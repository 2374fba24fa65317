"""The token that answers the board's challenge, and the challenges themselves.

This is no secret and keeps no attacker out. It shows that the sequencer is alive now, has read this very
challenge, and was built from the same DBC; a replayed or stuck stream of frames cannot arm the board.
"""

from __future__ import annotations


def arm_token(challenge: int, dbc_hash: int) -> int:
    """The 16-bit answer: (challenge XOR low half of the hash) rotated left by 5, XOR high half."""
    mixed = (challenge ^ dbc_hash) & 0xFFFF
    return ((mixed << 5 | mixed >> 11) & 0xFFFF) ^ (dbc_hash >> 16 & 0xFFFF)


def next_challenge(challenge: int) -> int:
    """The challenge after this one: Marsaglia's 16-bit xorshift (7, 9, 8), period 65535, never 0."""
    challenge ^= challenge << 7 & 0xFFFF
    challenge ^= challenge >> 9
    return challenge ^ (challenge << 8 & 0xFFFF)
