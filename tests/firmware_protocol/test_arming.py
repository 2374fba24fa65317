"""Challenges differ and are never 0; the token belongs to one challenge and one DBC."""

from __future__ import annotations

from firmware_protocol.arming import arm_token, next_challenge


def test_challenges_run_through_all_values_but_zero() -> None:
    seen, challenge = set(), 1
    for _ in range(65535):
        challenge = next_challenge(challenge)
        seen.add(challenge)
    assert seen == set(range(1, 65536))


def test_each_challenge_has_its_own_token() -> None:
    tokens = {arm_token(challenge, 0x1234ABCD) for challenge in range(65536)}
    assert tokens == set(range(65536))


def test_the_token_depends_on_both_halves_of_the_hash() -> None:
    token = arm_token(0x5A5A, 0x1234ABCD)
    assert token == (((0x5A5A ^ 0xABCD) << 5 | (0x5A5A ^ 0xABCD) >> 11) & 0xFFFF) ^ 0x1234
    for bit in range(32):
        assert arm_token(0x5A5A, 0x1234ABCD ^ 1 << bit) != token
