"""The C table of the board's parameters, made from `parameters`: numbers and least values stand in one place."""

from __future__ import annotations

from firmware_protocol.parameters import PARAMETERS


def c_parameter_table() -> dict[str, str]:
    """The text of `softbot_parameter_table.h` and `.c`, by name."""
    return {"softbot_parameter_table.h": _header(), "softbot_parameter_table.c": _source()}


_MADE = "/* Made from firmware_protocol/parameters.py by c_parameter_table.py: change that table, not this file. */"


def _header() -> str:
    return "\n".join(
        [
            _MADE,
            "#ifndef SOFTBOT_PARAMETER_TABLE_H",
            "#define SOFTBOT_PARAMETER_TABLE_H",
            "",
            "#include <stdbool.h>",
            "#include <stdint.h>",
            "",
            "/* Index into softbot_parameter_table[] and softbot_parameters_t.values. */",
            "typedef enum {",
            *(
                f"    SOFTBOT_PARAMETER_INDEX_{each.parameter.name} = {index}, /* [{each.unit}] {each.meaning} */"
                for index, each in enumerate(PARAMETERS)
            ),
            f"    SOFTBOT_PARAMETER_INDEX_COUNT = {len(PARAMETERS)}",
            "} softbot_parameter_index_t;",
            "",
            "/* minimum: the least value that can be written, of a parameter that can be written. */",
            "typedef struct {",
            "    uint8_t number;",
            "    bool writable;",
            "    uint32_t minimum;",
            "} softbot_parameter_spec_t;",
            "",
            "extern const softbot_parameter_spec_t softbot_parameter_table[SOFTBOT_PARAMETER_INDEX_COUNT];",
            "",
            "#endif",
            "",
        ]
    )


def _source() -> str:
    rows = []
    for each in PARAMETERS:
        writable, minimum = ("false", 0) if each.minimum is None else ("true", each.minimum)
        rows.append(
            f"    [SOFTBOT_PARAMETER_INDEX_{each.parameter.name}] = "
            f"{{.number = {int(each.parameter)}u, .writable = {writable}, .minimum = {minimum}u}},"
        )
    return "\n".join(
        [
            _MADE,
            '#include "softbot_parameter_table.h"',
            "",
            "const softbot_parameter_spec_t softbot_parameter_table[SOFTBOT_PARAMETER_INDEX_COUNT] = {",
            *rows,
            "};",
            "",
        ]
    )
