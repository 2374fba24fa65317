/*
 * The board as a shared library for firmware_protocol/c_board.py: structures flattened to arrays of one integer type,
 * so that no layout has to be told twice. No part of what goes into firmware.
 */
#include <stddef.h>

#include "softbot_board.h"
#include "softbot_physical.h"

size_t softbot_host_size(void);
bool softbot_host_init(softbot_board_t *board, const uint16_t limits[8], uint16_t challenge_seed,
                       const uint8_t version[3]);
void softbot_host_receive(softbot_board_t *board, uint32_t frame_id, const uint8_t data[], uint32_t length,
                          uint64_t now_us, int32_t received[3]);
void softbot_host_tick(softbot_board_t *board, uint64_t now_us, const int32_t pressures_hPa[], int32_t decision[8]);
uint32_t softbot_host_outgoing(softbot_board_t *board, uint64_t now_us, uint8_t frames[]);
uint32_t softbot_host_measurements(softbot_board_t *board, uint64_t now_us, const double physical[15],
                                   uint8_t main_supply_open, uint8_t frames[]);
uint32_t softbot_host_state(const softbot_board_t *board, int64_t state[]);
void softbot_host_transition(const softbot_board_t *board, uint32_t number, int64_t transition[3]);
uint32_t softbot_host_faults(const softbot_board_t *board, int64_t faults[]);
void softbot_host_reception(const softbot_board_t *board, uint32_t message, int64_t state[]);

size_t softbot_host_size(void)
{
    return sizeof(softbot_board_t);
}

bool softbot_host_init(softbot_board_t *board, const uint16_t limits[8], uint16_t challenge_seed,
                       const uint8_t version[3])
{
    const softbot_board_limits_t enforced = {
        .max_setpoint_hPa = limits[0],
        .over_pressure_hPa = limits[1],
        .command_timeout_ms = limits[2],
        .heartbeat_timeout_ms = limits[3],
        .arming_timeout_ms = limits[4],
        .reception = {
            .max_counter_delta = (uint8_t)limits[5],
            .window_frames = (uint8_t)limits[6],
            .tolerated_errors = (uint8_t)limits[7],
        },
    };
    const softbot_version_t of = {.major = version[0], .minor = version[1], .patch = version[2]};
    return softbot_board_init(board, &enforced, challenge_seed, of);
}

/* received: status, index of the message, beyond tolerance. */
void softbot_host_receive(softbot_board_t *board, uint32_t frame_id, const uint8_t data[], uint32_t length,
                          uint64_t now_us, int32_t received[3])
{
    const softbot_received_t judged = softbot_board_receive(board, frame_id, data, length, now_us);
    received[0] = (int32_t)judged.status;
    received[1] = (int32_t)judged.index;
    received[2] = judged.beyond_tolerance ? 1 : 0;
}

/* decision: mode, reason, safe, main supply open, four setpoints. */
void softbot_host_tick(softbot_board_t *board, uint64_t now_us, const int32_t pressures_hPa[], int32_t decision[8])
{
    const softbot_decision_t made = softbot_board_tick(board, now_us, pressures_hPa);
    decision[0] = (int32_t)made.mode;
    decision[1] = (int32_t)made.reason;
    decision[2] = made.safe ? 1 : 0;
    decision[3] = made.main_supply_open ? 1 : 0;
    for (uint32_t i = 0u; i < SOFTBOT_CHAMBERS; i++) {
        decision[4u + i] = made.setpoints_hPa[i];
    }
}

/* A frame is 11 bytes: identifier (low byte first), length, data. */
static void flatten(const softbot_frame_t from[], uint32_t count, uint8_t frames[])
{
    for (uint32_t i = 0u; i < count; i++) {
        uint8_t *const to = &frames[11u * i];
        to[0] = (uint8_t)(from[i].id & 0xFFu);
        to[1] = (uint8_t)(from[i].id >> 8u);
        to[2] = from[i].length;
        for (uint32_t byte = 0u; byte < SOFTBOT_FRAME_BYTES; byte++) {
            to[3u + byte] = (byte < from[i].length) ? from[i].data[byte] : 0u;
        }
    }
}

uint32_t softbot_host_outgoing(softbot_board_t *board, uint64_t now_us, uint8_t frames[])
{
    softbot_frame_t due[SOFTBOT_OUTGOING_FRAMES];
    const uint32_t count = softbot_board_outgoing(board, now_us, due);
    flatten(due, count, frames);
    return count;
}

/* physical: four pressures [kPa], four openings, supply [kPa], gyro x, y, z [rad/s], accelerometer x, y, z [m/s2]. */
uint32_t softbot_host_measurements(softbot_board_t *board, uint64_t now_us, const double physical[15],
                                   uint8_t main_supply_open, uint8_t frames[])
{
    softbot_measurements_t raw = {.valves = {.main_supply_open = main_supply_open}};
    softbot_frame_t due[SOFTBOT_MEASUREMENT_FRAMES];
    raw.pressures_valid = softbot_board_pressures_pressure0_from_kPa(physical[0], &raw.pressures.pressure0) &&
                          softbot_board_pressures_pressure1_from_kPa(physical[1], &raw.pressures.pressure1) &&
                          softbot_board_pressures_pressure2_from_kPa(physical[2], &raw.pressures.pressure2) &&
                          softbot_board_pressures_pressure3_from_kPa(physical[3], &raw.pressures.pressure3);
    raw.valves_valid = softbot_board_valves_opening0_from_number(physical[4], &raw.valves.opening0) &&
                       softbot_board_valves_opening1_from_number(physical[5], &raw.valves.opening1) &&
                       softbot_board_valves_opening2_from_number(physical[6], &raw.valves.opening2) &&
                       softbot_board_valves_opening3_from_number(physical[7], &raw.valves.opening3);
    raw.supply_valid = softbot_board_supply_supply_pressure_from_kPa(physical[8], &raw.supply.supply_pressure);
    raw.gyro_valid = softbot_imu_gyro_x_from_rad_s(physical[9], &raw.gyro.x) &&
                     softbot_imu_gyro_y_from_rad_s(physical[10], &raw.gyro.y) &&
                     softbot_imu_gyro_z_from_rad_s(physical[11], &raw.gyro.z);
    raw.accelerometer_valid = softbot_imu_accelerometer_x_from_m_s2(physical[12], &raw.accelerometer.x) &&
                              softbot_imu_accelerometer_y_from_m_s2(physical[13], &raw.accelerometer.y) &&
                              softbot_imu_accelerometer_z_from_m_s2(physical[14], &raw.accelerometer.z);
    const uint32_t count = softbot_board_measurements(board, now_us, &raw, due);
    flatten(due, count, frames);
    return count;
}

static int64_t time_of(const softbot_time_t *time)
{
    return time->known ? (int64_t)time->at_us : -1;
}

/* All that the machine remembers, as firmware_protocol/c_board.py names it; -1 for a time that is not known. */
uint32_t softbot_host_state(const softbot_board_t *board, int64_t state[])
{
    const softbot_safety_t *const safety = &board->safety;
    uint32_t at = 0u;
    state[at++] = (int64_t)safety->mode;
    state[at++] = (int64_t)safety->reason;
    state[at++] = (int64_t)safety->control_mode;
    for (uint32_t i = 0u; i < SOFTBOT_CHAMBERS; i++) {
        state[at++] = safety->setpoints_hPa[i];
    }
    state[at++] = safety->challenge;
    state[at++] = safety->challenge_seed;
    state[at++] = safety->pressures_valid ? 1 : 0;
    state[at++] = (int64_t)safety->bus_state;
    state[at++] = time_of(&safety->now);
    state[at++] = (int64_t)safety->started_us;
    state[at++] = (int64_t)safety->mode_since_us;
    state[at++] = time_of(&safety->setpoints_came);
    state[at++] = time_of(&safety->control_came);
    state[at++] = time_of(&safety->heartbeat_came);
    state[at++] = safety->transition_count;
    for (uint32_t i = 0u; i < (uint32_t)SOFTBOT_PARAMETER_INDEX_COUNT; i++) {
        state[at++] = safety->parameters.values[i];
    }
    return at;
}

/* transition: time [us], mode, reason of transition `number`, counted from 0, one of the last that are kept. */
void softbot_host_transition(const softbot_board_t *board, uint32_t number, int64_t transition[3])
{
    const softbot_transition_t *const kept = &board->safety.transitions[number % SOFTBOT_KEPT_TRANSITIONS];
    transition[0] = (int64_t)kept->at_us;
    transition[1] = (int64_t)kept->mode;
    transition[2] = (int64_t)kept->reason;
}

/* faults: reason, chamber, detail of each fault still to be sent, oldest first; returns how many there are. */
uint32_t softbot_host_faults(const softbot_board_t *board, int64_t faults[])
{
    for (uint32_t i = 0u; i < board->safety.fault_count; i++) {
        const softbot_board_fault_t *const kept =
            &board->safety.faults[(board->safety.first_fault + i) % SOFTBOT_KEPT_FAULTS];
        faults[3u * i] = kept->reason;
        faults[(3u * i) + 1u] = kept->chamber;
        faults[(3u * i) + 2u] = kept->detail;
    }
    return board->safety.fault_count;
}

/* state: frames not listed, and of one message: window bits, lost frames, last counter (-1: none), counts by status. */
void softbot_host_reception(const softbot_board_t *board, uint32_t message, int64_t state[])
{
    const softbot_message_reception_t *const entry = &board->reception.messages[message];
    state[0] = board->reception.not_listed;
    state[1] = entry->window_bits;
    state[2] = entry->receiver.lost_frames;
    state[3] = entry->receiver.has_last ? (int64_t)entry->receiver.last_counter : -1;
    for (uint32_t status = 0u; status < (uint32_t)SOFTBOT_FRAME_STATUS_COUNT; status++) {
        state[4u + status] = entry->counts[status];
    }
}
