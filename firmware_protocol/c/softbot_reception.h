/*
 * What a node lets in, as firmware_protocol/reception.py: the whitelist by identifier, direction and length, then
 * protection, then reserved bits and ranges.
 *
 * Each refusal of a listed message is remembered over the last frames of that message; more of them than the tolerance
 * means that the link is not trustworthy. A frame that is not listed is counted and otherwise ignored.
 */
#ifndef SOFTBOT_RECEPTION_H
#define SOFTBOT_RECEPTION_H

#include <stdbool.h>
#include <stdint.h>

#include "softbot_e2e.h"
#include "softbot_messages.h"

#define SOFTBOT_WINDOW_FRAMES_MAX 32u

/* Of a message's last window_frames frames (1 to 32) at most tolerated_errors may be refused. */
typedef struct {
    uint8_t max_counter_delta; /* largest accepted step of the counter, 1 to 14 */
    uint8_t window_frames;
    uint8_t tolerated_errors; /* below window_frames */
} softbot_reception_limits_t;

typedef struct {
    softbot_e2e_receiver_t receiver;
    uint32_t counts[SOFTBOT_FRAME_STATUS_COUNT]; /* frames by what was made of them */
    uint32_t window_bits;                        /* one bit a frame, newest lowest, 1 = refused */
} softbot_message_reception_t;

typedef struct {
    softbot_reception_limits_t limits;
    uint8_t node;            /* SOFTBOT_NODE_... */
    uint32_t counter_exempt; /* bit i: message i is accepted whatever its counter */
    uint32_t not_listed;
    softbot_message_reception_t messages[SOFTBOT_MESSAGE_COUNT];
} softbot_reception_t;

/* A judged frame. index: SOFTBOT_MESSAGE_COUNT when not listed. signals: to be used only when accepted. */
typedef struct {
    softbot_frame_status_t status;
    softbot_message_index_t index;
    bool beyond_tolerance; /* this refusal is one more than the tolerance over the window of its message */
    softbot_signals_t signals;
} softbot_received_t;

bool softbot_reception_limits_valid(const softbot_reception_limits_t *limits);

/* The limits must be valid. */
void softbot_reception_init(softbot_reception_t *reception, uint8_t node, const softbot_reception_limits_t *limits,
                            uint32_t counter_exempt);

/* Judges one frame of `length` bytes, as many as the controller received. */
softbot_received_t softbot_reception_accept(softbot_reception_t *reception, uint32_t frame_id, const uint8_t data[],
                                            uint32_t length);

/* Takes over stricter limits from now on. */
void softbot_reception_tighten(softbot_reception_t *reception, uint8_t max_counter_delta, uint8_t tolerated_errors);

/* Empties the windows of refusals; the counts stay. */
void softbot_reception_forgive(softbot_reception_t *reception);

/* Whether any window holds a refusal. */
bool softbot_reception_blemished(const softbot_reception_t *reception);

/* Frames of listed messages refused by CRC or counter; frames refused by identifier, direction, length or content. */
uint64_t softbot_reception_protection_errors(const softbot_reception_t *reception);
uint64_t softbot_reception_refused_frames(const softbot_reception_t *reception);

#endif
