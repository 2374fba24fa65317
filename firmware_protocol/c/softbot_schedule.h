/*
 * When a node's cyclic messages are due, from the DBC's cycle times, as firmware_protocol/schedule.py.
 *
 * Sending from the control loop itself, and not from a timer interrupt or a task of its own, is what makes a stopped
 * loop fall silent.
 */
#ifndef SOFTBOT_SCHEDULE_H
#define SOFTBOT_SCHEDULE_H

#include <stdbool.h>
#include <stdint.h>

#include "softbot_messages.h"

typedef struct {
    uint64_t next_us[SOFTBOT_MESSAGE_COUNT];
    bool started[SOFTBOT_MESSAGE_COUNT];
} softbot_schedule_t;

/* The first call of each message finds it due. */
void softbot_schedule_init(softbot_schedule_t *schedule);

/*
 * Whether a cyclic message is to be sent now; if so, the next time is one period after the one planned. Cycles that
 * were missed are left out rather than sent in a burst, and a clock that went backwards starts the cycle anew.
 */
bool softbot_schedule_due(softbot_schedule_t *schedule, softbot_message_index_t index, uint64_t now_us);

#endif
