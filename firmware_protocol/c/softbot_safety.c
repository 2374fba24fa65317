#include "softbot_safety.h"

#include "softbot_arming.h"

#define US_PER_MS 1000u

/* ---------------------------------------------------------------------- steps */

static void enter(softbot_safety_t *safety, softbot_board_mode_t mode, softbot_safe_reason_t reason)
{
    if ((safety->mode != mode) || (safety->reason != reason)) {
        softbot_transition_t *const kept = &safety->transitions[safety->transition_count % SOFTBOT_KEPT_TRANSITIONS];
        safety->mode = mode;
        safety->reason = reason;
        safety->mode_since_us = safety->now.at_us;
        safety->control_mode = SOFTBOT_CONTROL_MODE_DISARM;
        for (uint32_t i = 0u; i < SOFTBOT_CHAMBERS; i++) {
            safety->setpoints_hPa[i] = 0u;
        }
        safety->challenge = 0u;
        kept->at_us = safety->now.at_us;
        kept->mode = mode;
        kept->reason = reason;
        safety->transition_count += 1u;
    }
}

static void keep_fault(softbot_safety_t *safety, const softbot_board_fault_t *fault)
{
    if (safety->fault_count == SOFTBOT_KEPT_FAULTS) {
        safety->first_fault = (safety->first_fault + 1u) % SOFTBOT_KEPT_FAULTS;
        safety->fault_count -= 1u;
    }
    safety->faults[(safety->first_fault + safety->fault_count) % SOFTBOT_KEPT_FAULTS] = *fault;
    safety->fault_count += 1u;
}

static void begin_arming(softbot_safety_t *safety)
{
    safety->challenge_seed = softbot_next_challenge(safety->challenge_seed);
    safety->fault_count = 0u; /* a late report of an old latch would look like a new one */
    enter(safety, SOFTBOT_BOARD_MODE_ARMING, SOFTBOT_SAFE_REASON_NONE);
    safety->challenge = safety->challenge_seed;
}

static void latch(softbot_safety_t *safety, softbot_safe_reason_t reason, uint64_t detail)
{
    softbot_safety_latch(safety, reason, SOFTBOT_NO_CHAMBER, detail);
}

static void finish_arming(softbot_safety_t *safety, uint16_t token)
{
    const uint64_t timeout_us =
        (uint64_t)US_PER_MS * safety->parameters.values[SOFTBOT_PARAMETER_INDEX_HEARTBEAT_TIMEOUT];
    const uint64_t age_us = safety->now.at_us - safety->heartbeat_came.at_us;
    if (token != softbot_arm_token(safety->challenge, SOFTBOT_DBC_HASH)) {
        latch(safety, SOFTBOT_SAFE_REASON_ARMING_REFUSED, (uint64_t)SOFTBOT_CONTROL_MODE_ARM_CONFIRM);
    } else if (!safety->heartbeat_came.known) {
        latch(safety, SOFTBOT_SAFE_REASON_HEARTBEAT_TIMEOUT, SOFTBOT_DETAIL_MAX);
    } else if (age_us >= timeout_us) {
        latch(safety, SOFTBOT_SAFE_REASON_HEARTBEAT_TIMEOUT, age_us / US_PER_MS);
    } else {
        enter(safety, SOFTBOT_BOARD_MODE_ARMED, SOFTBOT_SAFE_REASON_NONE);
        safety->control_mode = SOFTBOT_CONTROL_MODE_ARM_CONFIRM;
    }
}

static void latch_if_old(softbot_safety_t *safety, softbot_parameter_index_t timeout, const softbot_time_t *last,
                         softbot_safe_reason_t reason)
{
    uint64_t since_us = safety->mode_since_us; /* a message may be missing for its timeout after arming, too */
    if (last->known && (last->at_us > since_us)) {
        since_us = last->at_us;
    }
    const uint64_t age_us = safety->now.at_us - since_us;
    if (age_us >= ((uint64_t)US_PER_MS * safety->parameters.values[timeout])) {
        latch(safety, reason, age_us / US_PER_MS);
    }
}

/* ---------------------------------------------------------------------- start and time */

void softbot_safety_init(softbot_safety_t *safety, const softbot_parameters_t *parameters, uint16_t challenge_seed)
{
    const softbot_safety_t at_power_up = {
        .mode = SOFTBOT_BOARD_MODE_SAFE_LATCHED,
        .reason = SOFTBOT_SAFE_REASON_POWER_UP,
        .control_mode = SOFTBOT_CONTROL_MODE_DISARM,
        .bus_state = SOFTBOT_BUS_STATE_ERROR_ACTIVE,
        .challenge_seed = challenge_seed,
        .parameters = *parameters,
    };
    *safety = at_power_up;
}

bool softbot_safety_is_safe(const softbot_safety_t *safety)
{
    return (safety->mode != SOFTBOT_BOARD_MODE_ARMED) || (safety->control_mode != SOFTBOT_CONTROL_MODE_RUN);
}

bool softbot_safety_is_active(const softbot_safety_t *safety)
{
    return (safety->mode == SOFTBOT_BOARD_MODE_ARMING) || (safety->mode == SOFTBOT_BOARD_MODE_ARMED);
}

bool softbot_safety_advance(softbot_safety_t *safety, uint64_t now_us)
{
    const bool forwards = !safety->now.known || (now_us >= safety->now.at_us);
    if (!safety->now.known) {
        safety->started_us = now_us;
        safety->mode_since_us = now_us;
    }
    safety->now.known = true;
    safety->now.at_us = now_us;
    if (!forwards) {
        safety->setpoints_came.known = false;
        safety->control_came.known = false;
        safety->heartbeat_came.known = false;
        latch(safety, SOFTBOT_SAFE_REASON_CLOCK_ERROR, 0u);
    }
    if (safety->mode == SOFTBOT_BOARD_MODE_ARMING) {
        const softbot_time_t never = {.known = false};
        latch_if_old(safety, SOFTBOT_PARAMETER_INDEX_ARMING_TIMEOUT, &never, SOFTBOT_SAFE_REASON_ARMING_TIMEOUT);
    } else if (safety->mode == SOFTBOT_BOARD_MODE_ARMED) {
        latch_if_old(safety, SOFTBOT_PARAMETER_INDEX_COMMAND_TIMEOUT, &safety->setpoints_came,
                     SOFTBOT_SAFE_REASON_COMMAND_TIMEOUT);
        latch_if_old(safety, SOFTBOT_PARAMETER_INDEX_COMMAND_TIMEOUT, &safety->control_came,
                     SOFTBOT_SAFE_REASON_COMMAND_TIMEOUT);
        latch_if_old(safety, SOFTBOT_PARAMETER_INDEX_HEARTBEAT_TIMEOUT, &safety->heartbeat_came,
                     SOFTBOT_SAFE_REASON_HEARTBEAT_TIMEOUT);
    } else {
        /* nothing is armed: nothing can be late */
    }
    return forwards;
}

/* ---------------------------------------------------------------------- what came on the bus */

void softbot_safety_emergency_stop(softbot_safety_t *safety, const softbot_emergency_stop_t *stop)
{
    latch(safety, SOFTBOT_SAFE_REASON_EMERGENCY_STOP, stop->reason);
}

static void control_while_armed(softbot_safety_t *safety, softbot_control_mode_t wanted)
{
    if (wanted == SOFTBOT_CONTROL_MODE_ARM_REQUEST) {
        /* An armed board is asked to arm by a sequencer that lost its memory of it. */
        latch(safety, SOFTBOT_SAFE_REASON_UNEXPECTED_MODE, (uint64_t)wanted);
    } else {
        safety->control_mode = wanted;
    }
}

static void control_while_arming(softbot_safety_t *safety, softbot_control_mode_t wanted, uint16_t token)
{
    if (wanted == SOFTBOT_CONTROL_MODE_ARM_CONFIRM) {
        finish_arming(safety, token);
    } else if (wanted == SOFTBOT_CONTROL_MODE_RUN) {
        latch(safety, SOFTBOT_SAFE_REASON_UNEXPECTED_MODE, (uint64_t)wanted);
    } else {
        /* a repeated request: the challenge stands */
    }
}

void softbot_safety_control(softbot_safety_t *safety, const softbot_sequencer_control_t *control)
{
    const softbot_control_mode_t wanted = (softbot_control_mode_t)control->mode;
    safety->control_came = safety->now;
    if (wanted == SOFTBOT_CONTROL_MODE_DISARM) {
        if ((safety->mode != SOFTBOT_BOARD_MODE_SAFE_LATCHED) || safety->pressures_valid) {
            enter(safety, SOFTBOT_BOARD_MODE_DISARMED, SOFTBOT_SAFE_REASON_NONE);
        }
    } else if (safety->mode == SOFTBOT_BOARD_MODE_SAFE_LATCHED) {
        /* only disarm leads out */
    } else if (control->dbc_hash != SOFTBOT_DBC_HASH) {
        latch(safety, SOFTBOT_SAFE_REASON_VERSION_MISMATCH, control->dbc_hash & SOFTBOT_DETAIL_MAX);
    } else if (safety->mode == SOFTBOT_BOARD_MODE_ARMED) {
        control_while_armed(safety, wanted);
    } else if (safety->mode == SOFTBOT_BOARD_MODE_ARMING) {
        control_while_arming(safety, wanted, control->arm_token);
    } else if (wanted == SOFTBOT_CONTROL_MODE_ARM_REQUEST) {
        begin_arming(safety);
    } else {
        /* a disarmed board has no use for confirm and run */
    }
}

void softbot_safety_setpoints(softbot_safety_t *safety, const softbot_sequencer_setpoints_t *wanted)
{
    safety->setpoints_came = safety->now;
    if (safety->mode == SOFTBOT_BOARD_MODE_ARMED) {
        const uint16_t wanted_hPa[SOFTBOT_CHAMBERS] = {wanted->setpoint0, wanted->setpoint1, wanted->setpoint2,
                                                       wanted->setpoint3};
        const uint32_t limit_hPa = safety->parameters.values[SOFTBOT_PARAMETER_INDEX_MAX_SETPOINT];
        uint32_t clamped = 0u;
        for (uint32_t i = 0u; i < SOFTBOT_CHAMBERS; i++) {
            safety->setpoints_hPa[i] = wanted_hPa[i];
            if (wanted_hPa[i] > limit_hPa) {
                safety->setpoints_hPa[i] = (uint16_t)limit_hPa;
                clamped += 1u;
            }
        }
        softbot_parameters_count(&safety->parameters, SOFTBOT_PARAMETER_INDEX_SETPOINTS_CLAMPED, clamped);
    }
}

void softbot_safety_heartbeat(softbot_safety_t *safety, const softbot_sequencer_heartbeat_t *heartbeat)
{
    safety->heartbeat_came = safety->now;
    if (softbot_safety_is_active(safety) && (heartbeat->health == (uint8_t)SOFTBOT_HEALTH_FAILED)) {
        latch(safety, SOFTBOT_SAFE_REASON_SEQUENCER_FAILED, 0u);
    }
}

void softbot_safety_beyond_tolerance(softbot_safety_t *safety, uint16_t frame_id)
{
    if (softbot_safety_is_active(safety)) {
        latch(safety, SOFTBOT_SAFE_REASON_PROTECTION_ERROR, frame_id);
    }
}

/* ---------------------------------------------------------------------- what the board finds itself */

void softbot_safety_measured(softbot_safety_t *safety, const int32_t pressures_hPa[SOFTBOT_CHAMBERS])
{
    const int64_t limit_hPa = safety->parameters.values[SOFTBOT_PARAMETER_INDEX_OVER_PRESSURE];
    bool valid = true;
    for (uint32_t i = 0u; valid && (i < SOFTBOT_CHAMBERS); i++) {
        if (pressures_hPa[i] == SOFTBOT_SENSOR_INVALID_hPa) {
            softbot_safety_latch(safety, SOFTBOT_SAFE_REASON_SENSOR_INVALID, (uint8_t)i, 0u);
            valid = false;
        } else if (pressures_hPa[i] > limit_hPa) {
            softbot_safety_latch(safety, SOFTBOT_SAFE_REASON_OVER_PRESSURE, (uint8_t)i, (uint64_t)pressures_hPa[i]);
            valid = false;
        } else {
            /* within the limit */
        }
    }
    safety->pressures_valid = valid;
}

void softbot_safety_bus(softbot_safety_t *safety, softbot_bus_state_t bus_state)
{
    safety->bus_state = (bus_state > SOFTBOT_BUS_STATE_BUS_OFF) ? SOFTBOT_BUS_STATE_BUS_OFF : bus_state;
    if (safety->bus_state == SOFTBOT_BUS_STATE_BUS_OFF) {
        latch(safety, SOFTBOT_SAFE_REASON_BUS_OFF, 0u);
    }
}

void softbot_safety_latch(softbot_safety_t *safety, softbot_safe_reason_t reason, uint8_t chamber, uint64_t detail)
{
    if ((safety->mode != SOFTBOT_BOARD_MODE_SAFE_LATCHED) || (safety->reason == SOFTBOT_SAFE_REASON_POWER_UP)) {
        const bool known = (reason > SOFTBOT_SAFE_REASON_POWER_UP) && (reason <= SOFTBOT_SAFE_REASON_CLOCK_ERROR);
        const softbot_board_fault_t fault = {
            .reason = known ? (uint8_t)reason : (uint8_t)SOFTBOT_SAFE_REASON_INTERNAL_ERROR,
            .chamber = chamber,
            .detail = (uint16_t)((detail < SOFTBOT_DETAIL_MAX) ? detail : SOFTBOT_DETAIL_MAX),
        };
        enter(safety, SOFTBOT_BOARD_MODE_SAFE_LATCHED, (softbot_safe_reason_t)fault.reason);
        softbot_parameters_count(&safety->parameters, SOFTBOT_PARAMETER_INDEX_LATCHES, 1u);
        keep_fault(safety, &fault);
    }
}

softbot_board_fault_t softbot_safety_take_fault(softbot_safety_t *safety)
{
    const softbot_board_fault_t oldest = safety->faults[safety->first_fault];
    safety->first_fault = (safety->first_fault + 1u) % SOFTBOT_KEPT_FAULTS;
    safety->fault_count -= 1u;
    return oldest;
}

softbot_health_t softbot_safety_health(const softbot_safety_t *safety, bool blemished)
{
    const bool failed = (safety->reason == SOFTBOT_SAFE_REASON_SENSOR_INVALID) ||
                        (safety->reason == SOFTBOT_SAFE_REASON_BUS_OFF) ||
                        (safety->reason == SOFTBOT_SAFE_REASON_INTERNAL_ERROR) ||
                        (safety->reason == SOFTBOT_SAFE_REASON_CLOCK_ERROR);
    softbot_health_t health = SOFTBOT_HEALTH_OK;
    if (failed) {
        health = SOFTBOT_HEALTH_FAILED;
    } else if (safety->bus_state != SOFTBOT_BUS_STATE_ERROR_ACTIVE) {
        health = SOFTBOT_HEALTH_DEGRADED;
    } else if (blemished) {
        health = SOFTBOT_HEALTH_WARNING;
    } else {
        /* nothing to complain of */
    }
    return health;
}
