#include "softbot_arming.h"

uint16_t softbot_arm_token(uint16_t challenge, uint32_t dbc_hash)
{
    const uint32_t mixed = (challenge ^ dbc_hash) & 0xFFFFu;
    const uint32_t rotated = ((mixed << 5u) | (mixed >> 11u)) & 0xFFFFu;
    return (uint16_t)(rotated ^ (dbc_hash >> 16u));
}

uint16_t softbot_next_challenge(uint16_t challenge)
{
    uint32_t next = challenge;
    next ^= (next << 7u) & 0xFFFFu;
    next ^= next >> 9u;
    next ^= (next << 8u) & 0xFFFFu;
    return (uint16_t)next;
}
