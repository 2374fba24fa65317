/* Plays a recorded sequence of events to a board in C: what test_c_board.py compares with the board in Python. */
#include <stddef.h>

#include "softbot_board.h"

size_t softbot_host_size(void);
bool softbot_host_init(softbot_board_t *board, const uint16_t limits[8], uint16_t challenge_seed,
                       const uint8_t version[3]);
void softbot_host_receive(softbot_board_t *board, uint32_t frame_id, const uint8_t data[], uint32_t length,
                          uint64_t now_us, int32_t received[3]);
void softbot_host_tick(softbot_board_t *board, uint64_t now_us, const int32_t pressures_hPa[], int32_t decision[8]);
uint32_t softbot_host_outgoing(softbot_board_t *board, uint64_t now_us, uint8_t frames[]);

enum { RECEIVE, TICK, OUTGOING, FAILURE, BUS };

typedef struct {
    uint64_t now_us;
    int32_t pressures_hPa[4];
    uint32_t number; /* identifier, reason, bus state */
    uint8_t kind;
    uint8_t length;
    uint8_t data[18];
} event_t;

typedef struct {
    int32_t result[8];
    int32_t state[4];
    uint8_t frames[66];
    uint8_t unused[2];
} outcome_t;

void replay(softbot_board_t *board, const uint16_t limits[8], uint16_t challenge_seed, size_t count,
            const event_t events[], outcome_t outcomes[]);

void replay(softbot_board_t *board, const uint16_t limits[8], uint16_t challenge_seed, size_t count,
            const event_t events[], outcome_t outcomes[])
{
    const uint8_t version[3] = {1u, 2u, 3u};
    (void)softbot_host_init(board, limits, challenge_seed, version);
    for (size_t i = 0u; i < count; i++) {
        const event_t *const event = &events[i];
        outcome_t *const outcome = &outcomes[i];
        if (event->kind == RECEIVE) {
            softbot_host_receive(board, event->number, event->data, event->length, event->now_us, outcome->result);
        } else if (event->kind == TICK) {
            softbot_host_tick(board, event->now_us, event->pressures_hPa, outcome->result);
        } else if (event->kind == OUTGOING) {
            outcome->result[0] = (int32_t)softbot_host_outgoing(board, event->now_us, outcome->frames);
        } else if (event->kind == FAILURE) {
            softbot_board_report_failure(board, (softbot_safe_reason_t)event->number, event->length);
        } else {
            softbot_board_report_bus(board, (softbot_bus_state_t)event->number, event->data[0], event->data[1]);
        }
        outcome->state[0] = (int32_t)board->safety.mode;
        outcome->state[1] = (int32_t)board->safety.reason;
        outcome->state[2] = (int32_t)board->safety.control_mode;
        outcome->state[3] = board->safety.challenge;
    }
}
