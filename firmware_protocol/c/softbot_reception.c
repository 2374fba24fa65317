#include "softbot_reception.h"

#include <stddef.h>

#define COUNTER_DELTA_MAX 14u

_Static_assert((uint32_t)SOFTBOT_MESSAGE_COUNT <= 32u, "softbot_reception_t.counter_exempt has a bit for each message");

/* Without a branch: stays at the highest value when it gets there. */
static uint32_t counted(uint32_t count)
{
    return count + (uint32_t)(count != UINT32_MAX);
}

static uint32_t ones_in(uint32_t bits)
{
    uint32_t count = 0u;
    for (uint32_t left = bits; left != 0u; left &= left - 1u) {
        count += 1u;
    }
    return count;
}

bool softbot_reception_limits_valid(const softbot_reception_limits_t *limits)
{
    return (limits->max_counter_delta >= 1u) && (limits->max_counter_delta <= COUNTER_DELTA_MAX) &&
           (limits->window_frames <= SOFTBOT_WINDOW_FRAMES_MAX) && (limits->tolerated_errors < limits->window_frames);
}

void softbot_reception_init(softbot_reception_t *reception, uint8_t node, const softbot_reception_limits_t *limits,
                            uint32_t counter_exempt)
{
    reception->limits = *limits;
    reception->node = node;
    reception->counter_exempt = counter_exempt;
    reception->not_listed = 0u;
    for (uint32_t i = 0u; i < (uint32_t)SOFTBOT_MESSAGE_COUNT; i++) {
        softbot_message_reception_t *const entry = &reception->messages[i];
        softbot_e2e_receiver_init(&entry->receiver, &softbot_messages[i], limits->max_counter_delta);
        entry->window_bits = 0u;
        for (uint32_t status = 0u; status < (uint32_t)SOFTBOT_FRAME_STATUS_COUNT; status++) {
            entry->counts[status] = 0u;
        }
    }
}

static softbot_message_index_t listed(const softbot_reception_t *reception, uint32_t frame_id)
{
    softbot_message_index_t found = SOFTBOT_MESSAGE_COUNT;
    for (uint32_t i = 0u; i < (uint32_t)SOFTBOT_MESSAGE_COUNT; i++) {
        const softbot_message_t *const message = &softbot_messages[i];
        if ((message->id == frame_id) && ((message->receivers & reception->node) != 0u)) {
            found = (softbot_message_index_t)i;
        }
    }
    return found;
}

static void judge(softbot_reception_t *reception, const uint8_t data[], uint32_t length, softbot_received_t *received)
{
    softbot_e2e_receiver_t *const receiver = &reception->messages[received->index].receiver;
    const bool exempt = ((reception->counter_exempt >> (uint32_t)received->index) & 1u) != 0u;
    received->status = SOFTBOT_FRAME_MALFORMED;
    if (length == receiver->message->length) {
        softbot_frame_status_t status = softbot_e2e_receive(receiver, data);
        if (exempt && (status != SOFTBOT_FRAME_WRONG_CRC)) {
            status = SOFTBOT_FRAME_OK;
        }
        if (!softbot_frame_accepted(status) || softbot_unpack(received->index, data, &received->signals)) {
            received->status = status;
        }
    }
}

softbot_received_t softbot_reception_accept(softbot_reception_t *reception, uint32_t frame_id, const uint8_t data[],
                                            uint32_t length)
{
    softbot_received_t received = {.status = SOFTBOT_FRAME_NOT_LISTED, .index = listed(reception, frame_id)};
    if (received.index == SOFTBOT_MESSAGE_COUNT) {
        reception->not_listed = counted(reception->not_listed);
    } else {
        softbot_message_reception_t *const entry = &reception->messages[received.index];
        const uint32_t window_mask = UINT32_MAX >> (SOFTBOT_WINDOW_FRAMES_MAX - reception->limits.window_frames);
        judge(reception, data, length, &received);
        entry->counts[received.status] = counted(entry->counts[received.status]);
        entry->window_bits = (entry->window_bits << 1u) & window_mask;
        if (!softbot_frame_accepted(received.status)) {
            entry->window_bits |= 1u;
            received.beyond_tolerance = ones_in(entry->window_bits) > reception->limits.tolerated_errors;
        }
    }
    return received;
}

void softbot_reception_tighten(softbot_reception_t *reception, uint8_t max_counter_delta, uint8_t tolerated_errors)
{
    reception->limits.max_counter_delta = max_counter_delta;
    reception->limits.tolerated_errors = tolerated_errors;
    for (uint32_t i = 0u; i < (uint32_t)SOFTBOT_MESSAGE_COUNT; i++) {
        reception->messages[i].receiver.max_delta = max_counter_delta;
    }
}

void softbot_reception_forgive(softbot_reception_t *reception)
{
    for (uint32_t i = 0u; i < (uint32_t)SOFTBOT_MESSAGE_COUNT; i++) {
        reception->messages[i].window_bits = 0u;
    }
}

bool softbot_reception_blemished(const softbot_reception_t *reception)
{
    uint32_t refusals = 0u;
    for (uint32_t i = 0u; i < (uint32_t)SOFTBOT_MESSAGE_COUNT; i++) {
        refusals |= reception->messages[i].window_bits;
    }
    return refusals != 0u;
}

uint64_t softbot_reception_protection_errors(const softbot_reception_t *reception)
{
    uint64_t errors = 0u;
    for (uint32_t i = 0u; i < (uint32_t)SOFTBOT_MESSAGE_COUNT; i++) {
        const uint32_t *const counts = reception->messages[i].counts;
        errors += (uint64_t)counts[SOFTBOT_FRAME_REPEATED] + counts[SOFTBOT_FRAME_WRONG_SEQUENCE] +
                  counts[SOFTBOT_FRAME_WRONG_CRC];
    }
    return errors;
}

uint64_t softbot_reception_refused_frames(const softbot_reception_t *reception)
{
    uint64_t refused = reception->not_listed;
    for (uint32_t i = 0u; i < (uint32_t)SOFTBOT_MESSAGE_COUNT; i++) {
        refused += reception->messages[i].counts[SOFTBOT_FRAME_MALFORMED];
    }
    return refused;
}
