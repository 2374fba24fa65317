#include "softbot_parameters.h"

void softbot_parameters_count(softbot_parameters_t *parameters, softbot_parameter_index_t index, uint32_t more)
{
    const uint32_t room = UINT32_MAX - parameters->values[index];
    parameters->values[index] += (more < room) ? more : room;
}

static softbot_abort_code_t write_value(softbot_parameters_t *parameters, softbot_parameter_index_t index,
                                        uint32_t value, bool may_write)
{
    const softbot_parameter_spec_t *const spec = &softbot_parameter_table[index];
    softbot_abort_code_t code = SOFTBOT_ABORT_CODE_DONE;
    if (!spec->writable) {
        code = SOFTBOT_ABORT_CODE_READ_ONLY;
    } else if (!may_write) {
        code = SOFTBOT_ABORT_CODE_WRONG_MODE;
    } else if (value > parameters->values[index]) {
        code = SOFTBOT_ABORT_CODE_WOULD_RAISE;
    } else if (value < spec->minimum) {
        code = SOFTBOT_ABORT_CODE_TOO_LOW;
    } else if ((index == SOFTBOT_PARAMETER_INDEX_OVER_PRESSURE) &&
               (value <= parameters->values[SOFTBOT_PARAMETER_INDEX_MAX_SETPOINT])) {
        code = SOFTBOT_ABORT_CODE_CONTRADICTS;
    } else {
        parameters->values[index] = value;
    }
    return code;
}

softbot_parameter_response_t softbot_parameters_execute(softbot_parameters_t *parameters,
                                                        const softbot_parameter_request_t *request, bool may_write)
{
    softbot_parameter_response_t answer = {
        .abort_code = (uint8_t)SOFTBOT_ABORT_CODE_UNKNOWN_PARAMETER,
        .parameter = request->parameter,
        .transaction = request->transaction,
        .value = 0u,
    };
    for (uint32_t i = 0u; i < (uint32_t)SOFTBOT_PARAMETER_INDEX_COUNT; i++) {
        if (softbot_parameter_table[i].number == request->parameter) {
            softbot_abort_code_t code = SOFTBOT_ABORT_CODE_DONE;
            if (request->operation == (uint8_t)SOFTBOT_PARAMETER_OPERATION_WRITE) {
                code = write_value(parameters, (softbot_parameter_index_t)i, request->value, may_write);
            }
            answer.abort_code = (uint8_t)code;
            answer.value = parameters->values[i];
        }
    }
    return answer;
}
