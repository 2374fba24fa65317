/*
 * The token that answers the board's challenge, and the challenges themselves, as firmware_protocol/arming.py.
 *
 * No secret, and no attacker is kept out: it shows that the sequencer is alive now, has read this very challenge, and
 * was built from the same DBC.
 */
#ifndef SOFTBOT_ARMING_H
#define SOFTBOT_ARMING_H

#include <stdint.h>

/* The answer: (challenge XOR low half of the hash) rotated left by 5, XOR high half. */
uint16_t softbot_arm_token(uint16_t challenge, uint32_t dbc_hash);

/* The challenge after this one: Marsaglia's 16-bit xorshift (7, 9, 8), period 65535; 0 is never reached, nor left. */
uint16_t softbot_next_challenge(uint16_t challenge);

#endif
