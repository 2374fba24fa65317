/*
 * The board's parameters, as firmware_protocol/parameters.py: what can be read over the bus, and the limits that can be
 * lowered until power-up, never raised. The table of them is generated (softbot_parameter_table.h).
 */
#ifndef SOFTBOT_PARAMETERS_H
#define SOFTBOT_PARAMETERS_H

#include <stdbool.h>
#include <stdint.h>

#include "softbot_messages.h"
#include "softbot_parameter_table.h"

/* The values in force, each in its parameter's own unit. */
typedef struct {
    uint32_t values[SOFTBOT_PARAMETER_INDEX_COUNT];
} softbot_parameters_t;

/* Counts up, and stays at 2^32 - 1 when it gets there. */
void softbot_parameters_count(softbot_parameters_t *parameters, softbot_parameter_index_t index, uint32_t more);

/* Does what a request asks for, if it is allowed, and gives the answer. may_write: the board is not active. */
softbot_parameter_response_t softbot_parameters_execute(softbot_parameters_t *parameters,
                                                        const softbot_parameter_request_t *request, bool may_write);

#endif
