/*
 * End-to-end protection after AUTOSAR E2E profile 2, as firmware_protocol/e2e.py.
 *
 * Byte 0 carries CRC-8H2F, the low nibble of byte 1 a counter from 0 to 15. The CRC runs over the bytes after it and
 * then over the DataID that the message's list has for this counter value.
 */
#ifndef SOFTBOT_E2E_H
#define SOFTBOT_E2E_H

#include <stdbool.h>
#include <stdint.h>

#include "softbot_messages.h"

/* What a receiver made of a frame. The first three are accepted, the others refused. */
typedef enum {
    SOFTBOT_FRAME_OK = 0,
    SOFTBOT_FRAME_OK_SOME_LOST = 1, /* the counter skipped, within the tolerance */
    SOFTBOT_FRAME_INITIAL = 2,      /* the first of its message: nothing to compare the counter with */
    SOFTBOT_FRAME_REPEATED = 3,
    SOFTBOT_FRAME_WRONG_SEQUENCE = 4, /* skipped more than is tolerated; the count is taken up from here */
    SOFTBOT_FRAME_WRONG_CRC = 5,
    SOFTBOT_FRAME_MALFORMED = 6,  /* wrong length, reserved bits set, or a value out of range under a right CRC */
    SOFTBOT_FRAME_NOT_LISTED = 7, /* no message that this node may receive */
    SOFTBOT_FRAME_STATUS_COUNT = 8
} softbot_frame_status_t;

bool softbot_frame_accepted(softbot_frame_status_t status);

/* Judges CRC and counter of one message. */
typedef struct {
    const softbot_message_t *message;
    uint8_t max_delta; /* the largest step of the counter that is accepted; 1: no frame may be lost */
    bool has_last;
    uint8_t last_counter;
    uint32_t lost_frames;
} softbot_e2e_receiver_t;

/* Sets counter (its low 4 bits count) and CRC in `data`, which has the message's length. */
void softbot_e2e_protect(const softbot_message_t *message, uint8_t data[], uint8_t counter);

/* Whether the CRC of `data`, which has the message's length, is that of a frame of this message. */
bool softbot_e2e_check(const softbot_message_t *message, const uint8_t data[]);

void softbot_e2e_receiver_init(softbot_e2e_receiver_t *receiver, const softbot_message_t *message, uint8_t max_delta);

/* Judges one frame of the message's length, and takes over its counter unless the CRC is wrong. */
softbot_frame_status_t softbot_e2e_receive(softbot_e2e_receiver_t *receiver, const uint8_t data[]);

#endif
