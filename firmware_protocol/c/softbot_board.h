/*
 * The valve board's protocol end, as firmware_protocol/board.py: frames and measurements in, a decision and frames out.
 *
 * A cycle of the board (10 ms): softbot_board_receive for every frame that came, softbot_board_tick with the measured
 * pressures, valves as the decision says, then send what softbot_board_outgoing and softbot_board_measurements give.
 *
 * Pressures are gauge in hPa (0.1 kPa), times in us on the board's monotonic clock since any start; the clock need not
 * begin at 0. All state is in softbot_board_t; no call blocks, allocates or recurses. Calls for one board must not
 * interrupt each other.
 */
#ifndef SOFTBOT_BOARD_H
#define SOFTBOT_BOARD_H

#include <stdbool.h>
#include <stdint.h>

#include "softbot_messages.h"
#include "softbot_reception.h"
#include "softbot_safety.h"
#include "softbot_schedule.h"

#define SOFTBOT_FRAME_BYTES 8u
#define SOFTBOT_OUTGOING_FRAMES 6u
#define SOFTBOT_MEASUREMENT_FRAMES 5u

/* What the board's maker sets: 0 < max_setpoint_hPa < over_pressure_hPa <= 8091; timeouts from 1 to 10000 ms. */
typedef struct {
    uint16_t max_setpoint_hPa;
    uint16_t over_pressure_hPa;
    uint16_t command_timeout_ms;
    uint16_t heartbeat_timeout_ms;
    uint16_t arming_timeout_ms;
    softbot_reception_limits_t reception;
} softbot_board_limits_t;

/* Of the firmware, for BoardBoot; major: 0 to 15. */
typedef struct {
    uint8_t major;
    uint8_t minor;
    uint8_t patch;
} softbot_version_t;

/* An 11-bit data frame. */
typedef struct {
    uint16_t id;
    uint8_t length;
    uint8_t data[SOFTBOT_FRAME_BYTES];
} softbot_frame_t;

/*
 * What the valves are to do in this cycle. safe: they belong in their safe state, main supply closed and exhausts open,
 * whatever the rest says; true in every mode but armed-and-run. setpoints_hPa: clamped to the limit, 0 when safe.
 */
typedef struct {
    softbot_board_mode_t mode;
    softbot_safe_reason_t reason;
    bool safe;
    bool main_supply_open;
    uint16_t setpoints_hPa[SOFTBOT_CHAMBERS];
} softbot_decision_t;

/*
 * What was measured in this cycle, in raw counts. A message whose `..._valid` is false is left out: the sequencer sees
 * it missing. The board's mode and the time are filled in.
 */
typedef struct {
    bool pressures_valid;
    softbot_board_pressures_t pressures;
    bool valves_valid;
    softbot_board_valves_t valves;
    bool supply_valid;
    softbot_board_supply_t supply;
    bool gyro_valid;
    softbot_imu_gyro_t gyro;
    bool accelerometer_valid;
    softbot_imu_accelerometer_t accelerometer;
} softbot_measurements_t;

typedef struct {
    softbot_safety_t safety;
    softbot_reception_t reception;
    softbot_schedule_t schedule;
    softbot_version_t version;
    uint8_t counters[SOFTBOT_MESSAGE_COUNT];
    uint8_t transmit_errors;
    uint8_t receive_errors;
    uint64_t next_event_us[SOFTBOT_MESSAGE_COUNT]; /* when the minimum gap of a message on an event is over */
    bool answer_waits;
    softbot_parameter_response_t answer;
    bool sync_waits;
    uint8_t sync_id;
    uint64_t sync_came_us;
} softbot_board_t;

/*
 * Power-up. challenge_seed: 1 to 65535, from a source of entropy. false: limits, seed or version are not allowed; the
 * board is then one that cannot be armed, so that a caller who does not look is safe all the same.
 */
bool softbot_board_init(softbot_board_t *board, const softbot_board_limits_t *limits, uint16_t challenge_seed,
                        softbot_version_t version);

/* Judges one frame of `length` bytes, as many as the controller received, and acts on it if it is accepted. */
softbot_received_t softbot_board_receive(softbot_board_t *board, uint32_t frame_id, const uint8_t data[],
                                         uint32_t length, uint64_t now_us);

/*
 * The cycle's decision, after checking timeouts and the measured pressures: rounded up, so that one is above a limit
 * exactly if the pressure is; SOFTBOT_SENSOR_INVALID_hPa for one that is not to be trusted.
 */
softbot_decision_t softbot_board_tick(softbot_board_t *board, uint64_t now_us,
                                      const int32_t pressures_hPa[SOFTBOT_CHAMBERS]);

/* Latches the safe state for what the board's other parts found. */
void softbot_board_report_failure(softbot_board_t *board, softbot_safe_reason_t reason, uint16_t detail);

/* Takes over what the CAN controller says of itself; bus-off latches the safe state. */
void softbot_board_report_bus(softbot_board_t *board, softbot_bus_state_t bus_state, uint8_t transmit_errors,
                              uint8_t receive_errors);

/* Fills in the frames besides the measurements that are due, in order of priority; returns how many. */
uint32_t softbot_board_outgoing(softbot_board_t *board, uint64_t now_us,
                                softbot_frame_t frames[SOFTBOT_OUTGOING_FRAMES]);

/* Fills in the measurement frames that are due; returns how many. */
uint32_t softbot_board_measurements(softbot_board_t *board, uint64_t now_us,
                                    const softbot_measurements_t *measurements,
                                    softbot_frame_t frames[SOFTBOT_MEASUREMENT_FRAMES]);

#endif
