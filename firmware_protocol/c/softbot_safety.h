/*
 * The board's safety state machine, as firmware_protocol/safety.py; the rules are told in firmware_protocol/board.py.
 *
 * Pressures are gauge in hPa (0.1 kPa, the step of the bus), times in us on the board's clock since any start. Every
 * input is preceded by softbot_safety_advance; what the machine decides depends on the inputs and their times alone.
 */
#ifndef SOFTBOT_SAFETY_H
#define SOFTBOT_SAFETY_H

#include <stdbool.h>
#include <stdint.h>

#include "softbot_messages.h"
#include "softbot_parameters.h"

/* Stands for a measured pressure that is not to be trusted: sensor broken, converter failed. */
#define SOFTBOT_SENSOR_INVALID_hPa INT32_MIN
#define SOFTBOT_DETAIL_MAX 0xFFFFu
#define SOFTBOT_KEPT_TRANSITIONS 16u
#define SOFTBOT_KEPT_FAULTS 8u

/* A time in us that may not be there: not yet, or forgotten. */
typedef struct {
    bool known;
    uint64_t at_us;
} softbot_time_t;

/* A change of mode; reason is NONE unless the new mode is SAFE_LATCHED. */
typedef struct {
    uint64_t at_us;
    softbot_board_mode_t mode;
    softbot_safe_reason_t reason;
} softbot_transition_t;

typedef struct {
    softbot_board_mode_t mode;
    softbot_safe_reason_t reason;
    softbot_control_mode_t control_mode;
    uint16_t setpoints_hPa[SOFTBOT_CHAMBERS];
    uint16_t challenge;
    uint16_t challenge_seed;
    bool pressures_valid;
    softbot_bus_state_t bus_state;
    softbot_time_t now;
    uint64_t started_us;
    uint64_t mode_since_us;
    softbot_time_t setpoints_came;
    softbot_time_t control_came;
    softbot_time_t heartbeat_came;
    softbot_parameters_t parameters;
    /* Faults that are still to be sent, oldest at first_fault; when full, the oldest makes room. */
    softbot_board_fault_t faults[SOFTBOT_KEPT_FAULTS];
    uint32_t first_fault;
    uint32_t fault_count;
    /* The last transitions, for a look after the fact: number n stands at n modulo SOFTBOT_KEPT_TRANSITIONS. */
    softbot_transition_t transitions[SOFTBOT_KEPT_TRANSITIONS];
    uint32_t transition_count;
} softbot_safety_t;

/* Power-up: latched. challenge_seed: 1 to 65535, from a source of entropy. */
void softbot_safety_init(softbot_safety_t *safety, const softbot_parameters_t *parameters, uint16_t challenge_seed);

/* Whether the valves belong in their safe state: in every mode but armed-and-run. */
bool softbot_safety_is_safe(const softbot_safety_t *safety);

/* Whether the board is arming or armed: there is something to protect. */
bool softbot_safety_is_active(const softbot_safety_t *safety);

/* Takes over the time and checks what depends on it alone. false: the clock went backwards. */
bool softbot_safety_advance(softbot_safety_t *safety, uint64_t now_us);

/* What came on the bus and was accepted. */
void softbot_safety_emergency_stop(softbot_safety_t *safety, const softbot_emergency_stop_t *stop);
void softbot_safety_control(softbot_safety_t *safety, const softbot_sequencer_control_t *control);
void softbot_safety_setpoints(softbot_safety_t *safety, const softbot_sequencer_setpoints_t *wanted);
void softbot_safety_heartbeat(softbot_safety_t *safety, const softbot_sequencer_heartbeat_t *heartbeat);

/* More frames of this identifier were refused than is tolerated. */
void softbot_safety_beyond_tolerance(softbot_safety_t *safety, uint16_t frame_id);

/* The measured chamber pressures, rounded up. */
void softbot_safety_measured(softbot_safety_t *safety, const int32_t pressures_hPa[SOFTBOT_CHAMBERS]);

/* What the CAN controller says of itself; what is no state counts as bus-off. */
void softbot_safety_bus(softbot_safety_t *safety, softbot_bus_state_t bus_state);

/*
 * Enters the latched safe state; the first reason stays until disarmed. What is no reason to latch counts as an
 * internal error.
 */
void softbot_safety_latch(softbot_safety_t *safety, softbot_safe_reason_t reason, uint8_t chamber, uint64_t detail);

/* Takes the oldest fault that is still to be sent; there must be one (fault_count > 0). */
softbot_board_fault_t softbot_safety_take_fault(softbot_safety_t *safety);

/* The board's judgement of itself; blemished: a frame was refused lately. */
softbot_health_t softbot_safety_health(const softbot_safety_t *safety, bool blemished);

#endif
