#include "softbot_schedule.h"

/* A loop of 10 ms that comes up to this much early still sends in the cycle it belongs to. */
#define SLACK_US 4000u

void softbot_schedule_init(softbot_schedule_t *schedule)
{
    for (uint32_t i = 0u; i < (uint32_t)SOFTBOT_MESSAGE_COUNT; i++) {
        schedule->next_us[i] = 0u;
        schedule->started[i] = false;
    }
}

bool softbot_schedule_due(softbot_schedule_t *schedule, softbot_message_index_t index, uint64_t now_us)
{
    const uint64_t period_us = softbot_messages[index].cycle_us;
    const uint64_t half_us = period_us / 2u;
    const uint64_t slack_us = (half_us < SLACK_US) ? half_us : SLACK_US;
    uint64_t next_us = schedule->next_us[index];
    bool due = false;
    if (!schedule->started[index] || ((now_us + (2u * period_us)) < next_us)) {
        next_us = now_us;
    }
    if ((now_us + slack_us) >= next_us) {
        due = true;
        next_us += period_us;
        schedule->next_us[index] = (next_us > now_us) ? next_us : (now_us + period_us);
        schedule->started[index] = true;
    }
    return due;
}
