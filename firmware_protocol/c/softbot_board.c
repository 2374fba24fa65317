#include "softbot_board.h"

#define US_PER_MS 1000u
#define US_PER_S 1000000u
#define PRESSURE_MAX_hPa 8091u /* the highest that BoardPressures can carry */
#define TIMEOUT_MAX_MS 10000u
#define VERSION_MAJOR_MAX 15u
#define EXEMPT_FROM_COUNTER (UINT32_C(1) << (uint32_t)SOFTBOT_MESSAGE_EMERGENCY_STOP)

/* ---------------------------------------------------------------------- start */

static bool timeout_valid(uint16_t timeout_ms)
{
    return (timeout_ms >= 1u) && (timeout_ms <= TIMEOUT_MAX_MS);
}

static bool limits_valid(const softbot_board_limits_t *limits)
{
    return (limits->max_setpoint_hPa > 0u) && (limits->max_setpoint_hPa < limits->over_pressure_hPa) &&
           (limits->over_pressure_hPa <= PRESSURE_MAX_hPa) && timeout_valid(limits->command_timeout_ms) &&
           timeout_valid(limits->heartbeat_timeout_ms) && timeout_valid(limits->arming_timeout_ms) &&
           softbot_reception_limits_valid(&limits->reception);
}

static softbot_parameters_t parameters_of(const softbot_board_limits_t *limits)
{
    const softbot_parameters_t parameters = {
        .values = {
            [SOFTBOT_PARAMETER_INDEX_MAX_SETPOINT] = limits->max_setpoint_hPa,
            [SOFTBOT_PARAMETER_INDEX_OVER_PRESSURE] = limits->over_pressure_hPa,
            [SOFTBOT_PARAMETER_INDEX_COMMAND_TIMEOUT] = limits->command_timeout_ms,
            [SOFTBOT_PARAMETER_INDEX_HEARTBEAT_TIMEOUT] = limits->heartbeat_timeout_ms,
            [SOFTBOT_PARAMETER_INDEX_ARMING_TIMEOUT] = limits->arming_timeout_ms,
            [SOFTBOT_PARAMETER_INDEX_MAX_COUNTER_DELTA] = limits->reception.max_counter_delta,
            [SOFTBOT_PARAMETER_INDEX_TOLERATED_ERRORS] = limits->reception.tolerated_errors,
            [SOFTBOT_PARAMETER_INDEX_WINDOW_FRAMES] = limits->reception.window_frames,
        },
    };
    return parameters;
}

bool softbot_board_init(softbot_board_t *board, const softbot_board_limits_t *limits, uint16_t challenge_seed,
                        softbot_version_t version)
{
    /* With all of these 0, arming times out at once and a setpoint is clamped to nothing. */
    const softbot_board_limits_t nothing_allowed = {.reception = {.max_counter_delta = 1u, .window_frames = 1u}};
    const bool valid = limits_valid(limits) && (challenge_seed != 0u) && (version.major <= VERSION_MAJOR_MAX);
    const softbot_board_limits_t *const enforced = valid ? limits : &nothing_allowed;
    const softbot_parameters_t parameters = parameters_of(enforced);
    const softbot_board_t at_power_up = {.version = version};
    *board = at_power_up;
    softbot_safety_init(&board->safety, &parameters, challenge_seed);
    softbot_reception_init(&board->reception, SOFTBOT_NODE_BOARD, &enforced->reception, EXEMPT_FROM_COUNTER);
    softbot_schedule_init(&board->schedule);
    return valid;
}

/* ---------------------------------------------------------------------- what comes in */

static void advance(softbot_board_t *board, uint64_t now_us)
{
    if (!softbot_safety_advance(&board->safety, now_us)) {
        for (uint32_t i = 0u; i < (uint32_t)SOFTBOT_MESSAGE_COUNT; i++) {
            board->next_event_us[i] = now_us;
        }
    }
}

static void act_on_control(softbot_board_t *board, const softbot_sequencer_control_t *control)
{
    const bool was_active = softbot_safety_is_active(&board->safety);
    softbot_safety_control(&board->safety, control);
    if (!was_active && softbot_safety_is_active(&board->safety)) {
        softbot_reception_forgive(&board->reception); /* what was refused before says nothing about this handshake */
    }
}

static void act_on_parameter_request(softbot_board_t *board, const softbot_parameter_request_t *request)
{
    softbot_parameters_t *const parameters = &board->safety.parameters;
    board->answer = softbot_parameters_execute(parameters, request, !softbot_safety_is_active(&board->safety));
    board->answer_waits = true;
    softbot_reception_tighten(&board->reception,
                              (uint8_t)parameters->values[SOFTBOT_PARAMETER_INDEX_MAX_COUNTER_DELTA],
                              (uint8_t)parameters->values[SOFTBOT_PARAMETER_INDEX_TOLERATED_ERRORS]);
}

static void act_on(softbot_board_t *board, const softbot_signals_t *signals, uint64_t now_us)
{
    if (signals->index == SOFTBOT_MESSAGE_EMERGENCY_STOP) {
        softbot_safety_emergency_stop(&board->safety, &signals->of.emergency_stop);
    } else if (signals->index == SOFTBOT_MESSAGE_SEQUENCER_CONTROL) {
        act_on_control(board, &signals->of.sequencer_control);
    } else if (signals->index == SOFTBOT_MESSAGE_SEQUENCER_SETPOINTS) {
        softbot_safety_setpoints(&board->safety, &signals->of.sequencer_setpoints);
    } else if (signals->index == SOFTBOT_MESSAGE_SEQUENCER_HEARTBEAT) {
        softbot_safety_heartbeat(&board->safety, &signals->of.sequencer_heartbeat);
    } else if (signals->index == SOFTBOT_MESSAGE_PARAMETER_REQUEST) {
        act_on_parameter_request(board, &signals->of.parameter_request);
    } else if (signals->index == SOFTBOT_MESSAGE_TIME_SYNC_REQUEST) {
        board->sync_waits = true;
        board->sync_id = signals->of.time_sync_request.sync_id;
        board->sync_came_us = now_us;
    } else {
        /* for logs and displays: the board does not act on it */
    }
}

softbot_received_t softbot_board_receive(softbot_board_t *board, uint32_t frame_id, const uint8_t data[],
                                         uint32_t length, uint64_t now_us)
{
    /* Timeouts first: a frame that comes too late must not hide that it was late. */
    advance(board, now_us);
    const softbot_received_t received = softbot_reception_accept(&board->reception, frame_id, data, length);
    if (received.beyond_tolerance) {
        softbot_safety_beyond_tolerance(&board->safety, softbot_messages[received.index].id);
    }
    if (softbot_frame_accepted(received.status)) {
        act_on(board, &received.signals, now_us);
    }
    return received;
}

softbot_decision_t softbot_board_tick(softbot_board_t *board, uint64_t now_us,
                                      const int32_t pressures_hPa[SOFTBOT_CHAMBERS])
{
    softbot_safety_t *const safety = &board->safety;
    advance(board, now_us);
    softbot_safety_measured(safety, pressures_hPa);
    softbot_decision_t decision = {.mode = safety->mode, .reason = safety->reason, .safe = true};
    if (!softbot_safety_is_safe(safety)) {
        decision.safe = false;
        decision.main_supply_open = true;
        for (uint32_t i = 0u; i < SOFTBOT_CHAMBERS; i++) {
            decision.setpoints_hPa[i] = safety->setpoints_hPa[i];
        }
    }
    return decision;
}

void softbot_board_report_failure(softbot_board_t *board, softbot_safe_reason_t reason, uint16_t detail)
{
    softbot_safety_latch(&board->safety, reason, SOFTBOT_NO_CHAMBER, detail);
}

void softbot_board_report_bus(softbot_board_t *board, softbot_bus_state_t bus_state, uint8_t transmit_errors,
                              uint8_t receive_errors)
{
    board->transmit_errors = transmit_errors;
    board->receive_errors = receive_errors;
    softbot_safety_bus(&board->safety, bus_state);
}

/* ---------------------------------------------------------------------- what goes out */

/* Packs, counts and protects into frames[count], unless a value is not allowed; returns the new count. */
static uint32_t send(softbot_board_t *board, const softbot_signals_t *signals, softbot_frame_t frames[], uint32_t count)
{
    const softbot_message_t *const message = &softbot_messages[signals->index];
    softbot_frame_t *const frame = &frames[count];
    uint32_t sent = 0u;
    if (softbot_pack(signals, frame->data)) {
        uint8_t *const counter = &board->counters[signals->index];
        frame->id = message->id;
        frame->length = message->length;
        softbot_e2e_protect(message, frame->data, *counter);
        *counter = (uint8_t)((*counter + 1u) % SOFTBOT_COUNTER_VALUES);
        sent = 1u;
    }
    return count + sent;
}

/* Whether the minimum gap of a message on an event is over; if so, it begins anew. */
static bool event_due(softbot_board_t *board, softbot_message_index_t index, uint64_t now_us)
{
    const bool due = now_us >= board->next_event_us[index];
    if (due) {
        board->next_event_us[index] = now_us + softbot_messages[index].gap_us;
    }
    return due;
}

static uint64_t since(uint64_t now_us, uint64_t then_us)
{
    return (now_us > then_us) ? (now_us - then_us) : 0u;
}

static uint64_t at_most(uint64_t value, uint64_t highest)
{
    return (value < highest) ? value : highest;
}

static softbot_signals_t heartbeat_of(const softbot_board_t *board, uint64_t now_us)
{
    const softbot_safety_t *const safety = &board->safety;
    const uint64_t uptime_s = since(now_us, safety->started_us) / US_PER_S;
    const softbot_health_t health = softbot_safety_health(safety, softbot_reception_blemished(&board->reception));
    const softbot_signals_t signals = {
        .index = SOFTBOT_MESSAGE_BOARD_HEARTBEAT,
        .of.board_heartbeat = {
            .board_mode = (uint8_t)safety->mode,
            .safe_reason = (uint8_t)safety->reason,
            .health = (uint8_t)health,
            .arm_challenge = safety->challenge,
            .uptime_s = (uint32_t)at_most(uptime_s, UINT32_MAX),
        },
    };
    return signals;
}

static softbot_signals_t boot_of(const softbot_board_t *board)
{
    const softbot_signals_t signals = {
        .index = SOFTBOT_MESSAGE_BOARD_BOOT,
        .of.board_boot = {
            .version_major = board->version.major,
            .version_minor = board->version.minor,
            .version_patch = board->version.patch,
            .dbc_hash = SOFTBOT_DBC_HASH,
        },
    };
    return signals;
}

static softbot_signals_t sync_of(const softbot_board_t *board, uint64_t now_us)
{
    const softbot_signals_t signals = {
        .index = SOFTBOT_MESSAGE_TIME_SYNC_RESPONSE,
        .of.time_sync_response = {
            .sync_id = board->sync_id,
            .receive_us = (uint32_t)(board->sync_came_us & UINT32_MAX),
            .hold_us = (uint16_t)at_most(since(now_us, board->sync_came_us), UINT16_MAX),
        },
    };
    return signals;
}

static softbot_signals_t errors_of(const softbot_board_t *board)
{
    const softbot_reception_t *const reception = &board->reception;
    const softbot_signals_t signals = {
        .index = SOFTBOT_MESSAGE_BOARD_ERRORS,
        .of.board_errors = {
            .bus_state = (uint8_t)board->safety.bus_state,
            .transmit_errors = board->transmit_errors,
            .receive_errors = board->receive_errors,
            .protection_errors = (uint16_t)at_most(softbot_reception_protection_errors(reception), UINT16_MAX),
            .refused_frames = (uint16_t)at_most(softbot_reception_refused_frames(reception), UINT16_MAX),
        },
    };
    return signals;
}

uint32_t softbot_board_outgoing(softbot_board_t *board, uint64_t now_us,
                                softbot_frame_t frames[SOFTBOT_OUTGOING_FRAMES])
{
    uint32_t count = 0u;
    if ((board->safety.fault_count > 0u) && event_due(board, SOFTBOT_MESSAGE_BOARD_FAULT, now_us)) {
        const softbot_signals_t signals = {
            .index = SOFTBOT_MESSAGE_BOARD_FAULT,
            .of.board_fault = softbot_safety_take_fault(&board->safety),
        };
        count = send(board, &signals, frames, count);
    }
    if (softbot_schedule_due(&board->schedule, SOFTBOT_MESSAGE_BOARD_HEARTBEAT, now_us)) {
        const softbot_signals_t signals = heartbeat_of(board, now_us);
        count = send(board, &signals, frames, count);
    }
    if (softbot_schedule_due(&board->schedule, SOFTBOT_MESSAGE_BOARD_BOOT, now_us)) {
        const softbot_signals_t signals = boot_of(board);
        count = send(board, &signals, frames, count);
    }
    if (board->answer_waits && event_due(board, SOFTBOT_MESSAGE_PARAMETER_RESPONSE, now_us)) {
        const softbot_signals_t signals = {
            .index = SOFTBOT_MESSAGE_PARAMETER_RESPONSE,
            .of.parameter_response = board->answer,
        };
        board->answer_waits = false;
        count = send(board, &signals, frames, count);
    }
    if (board->sync_waits && event_due(board, SOFTBOT_MESSAGE_TIME_SYNC_RESPONSE, now_us)) {
        const softbot_signals_t signals = sync_of(board, now_us);
        board->sync_waits = false;
        count = send(board, &signals, frames, count);
    }
    if (softbot_schedule_due(&board->schedule, SOFTBOT_MESSAGE_BOARD_ERRORS, now_us)) {
        const softbot_signals_t signals = errors_of(board);
        count = send(board, &signals, frames, count);
    }
    return count;
}

uint32_t softbot_board_measurements(softbot_board_t *board, uint64_t now_us,
                                    const softbot_measurements_t *measurements,
                                    softbot_frame_t frames[SOFTBOT_MEASUREMENT_FRAMES])
{
    softbot_signals_t signals[SOFTBOT_MEASUREMENT_FRAMES] = {
        {.index = SOFTBOT_MESSAGE_BOARD_PRESSURES, .of.board_pressures = measurements->pressures},
        {.index = SOFTBOT_MESSAGE_BOARD_VALVES, .of.board_valves = measurements->valves},
        {.index = SOFTBOT_MESSAGE_BOARD_SUPPLY, .of.board_supply = measurements->supply},
        {.index = SOFTBOT_MESSAGE_IMU_GYRO, .of.imu_gyro = measurements->gyro},
        {.index = SOFTBOT_MESSAGE_IMU_ACCELEROMETER, .of.imu_accelerometer = measurements->accelerometer},
    };
    const bool valid[SOFTBOT_MEASUREMENT_FRAMES] = {
        measurements->pressures_valid, measurements->valves_valid,        measurements->supply_valid,
        measurements->gyro_valid,      measurements->accelerometer_valid,
    };
    uint32_t count = 0u;
    signals[1].of.board_valves.board_mode = (uint8_t)board->safety.mode;
    signals[2].of.board_supply.sample_time_ms = (uint16_t)((now_us / US_PER_MS) & UINT16_MAX);
    for (uint32_t i = 0u; i < SOFTBOT_MEASUREMENT_FRAMES; i++) {
        if (softbot_schedule_due(&board->schedule, signals[i].index, now_us) && valid[i]) {
            count = send(board, &signals[i], frames, count);
        }
    }
    return count;
}
