#include "softbot_e2e.h"

#define CRC_8H2F_POLYNOMIAL 0x2Fu
#define CRC_8H2F_START 0xFFu
#define CRC_8H2F_FINAL_XOR 0xFFu
#define COUNTER_MASK 0x0Fu

/* Bit by bit: 64 steps a frame are little on any controller, and there is no table that could be wrong. */
static uint8_t crc_8h2f_add(uint8_t crc, uint8_t byte)
{
    uint32_t shifted = (uint32_t)crc ^ byte;
    for (uint32_t bit = 0u; bit < 8u; bit++) {
        shifted <<= 1u;
        if ((shifted & 0x100u) != 0u) {
            shifted ^= 0x100u | CRC_8H2F_POLYNOMIAL;
        }
    }
    return (uint8_t)shifted;
}

static uint8_t crc_of(const softbot_message_t *message, const uint8_t data[])
{
    uint8_t crc = CRC_8H2F_START;
    for (uint32_t i = 1u; i < message->length; i++) {
        crc = crc_8h2f_add(crc, data[i]);
    }
    crc = crc_8h2f_add(crc, message->data_ids[data[1] & COUNTER_MASK]);
    return (uint8_t)(crc ^ CRC_8H2F_FINAL_XOR);
}

bool softbot_frame_accepted(softbot_frame_status_t status)
{
    return status <= SOFTBOT_FRAME_INITIAL;
}

void softbot_e2e_protect(const softbot_message_t *message, uint8_t data[], uint8_t counter)
{
    const uint32_t payload_nibble = data[1] & ~COUNTER_MASK;
    data[1] = (uint8_t)(payload_nibble | (counter & COUNTER_MASK));
    data[0] = crc_of(message, data);
}

bool softbot_e2e_check(const softbot_message_t *message, const uint8_t data[])
{
    return crc_of(message, data) == data[0];
}

void softbot_e2e_receiver_init(softbot_e2e_receiver_t *receiver, const softbot_message_t *message, uint8_t max_delta)
{
    receiver->message = message;
    receiver->max_delta = max_delta;
    receiver->has_last = false;
    receiver->last_counter = 0u;
    receiver->lost_frames = 0u;
}

softbot_frame_status_t softbot_e2e_receive(softbot_e2e_receiver_t *receiver, const uint8_t data[])
{
    softbot_frame_status_t status;
    if (!softbot_e2e_check(receiver->message, data)) {
        status = SOFTBOT_FRAME_WRONG_CRC;
    } else {
        const uint8_t counter = (uint8_t)(data[1] & COUNTER_MASK);
        const uint8_t delta = (uint8_t)((uint32_t)counter - receiver->last_counter) & COUNTER_MASK;
        if (!receiver->has_last) {
            status = SOFTBOT_FRAME_INITIAL;
        } else if (delta == 0u) {
            status = SOFTBOT_FRAME_REPEATED;
        } else if (delta > receiver->max_delta) {
            status = SOFTBOT_FRAME_WRONG_SEQUENCE;
        } else {
            receiver->lost_frames += (uint32_t)delta - 1u;
            status = (delta == 1u) ? SOFTBOT_FRAME_OK : SOFTBOT_FRAME_OK_SOME_LOST;
        }
        receiver->has_last = true;
        receiver->last_counter = counter;
    }
    return status;
}
