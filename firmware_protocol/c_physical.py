"""`softbot_physical` of the C codec: each scaled signal from and to its unit, rounded as `codec` rounds."""

from __future__ import annotations

from collections.abc import Iterable

from firmware_protocol.c_names import GENERATED, c_type, function_prefix, payload, snake_case, unit_suffix
from firmware_protocol.codec import RANGE_SLACK_STEPS
from firmware_protocol.errors import SpecError
from firmware_protocol.spec import MessageSpec, ProtocolSpec, SignalKind, SignalSpec

_EXACT_BITS = 53
"""Longest signal whose every raw value a double holds."""


def _scaled(protocol: ProtocolSpec) -> Iterable[tuple[MessageSpec, SignalSpec]]:
    """The signals whose physical value is not the raw one."""
    for message in protocol.messages:
        for signal in payload(message):
            if not signal.whole:
                if signal.length > _EXACT_BITS:
                    raise SpecError(
                        f"{message.name}.{signal.name}: scaled, and {signal.length} bits are more than the "
                        f"{_EXACT_BITS} that a double holds; shorten it, or give it scale 1 and offset 0"
                    )
                yield message, signal


def to_raw_name(message: MessageSpec, signal: SignalSpec) -> str:
    """`softbot_board_pressures_pressure0_from_kPa`."""
    return f"{function_prefix(message)}_{snake_case(signal.name)}_from_{unit_suffix(signal)}"


def to_physical_name(message: MessageSpec, signal: SignalSpec) -> str:
    """`softbot_board_pressures_pressure0_in_kPa`."""
    return f"{function_prefix(message)}_{snake_case(signal.name)}_in_{unit_suffix(signal)}"


def _to_raw_prototype(message: MessageSpec, signal: SignalSpec) -> str:
    return f"bool {to_raw_name(message, signal)}(double physical, {c_type(signal)} *raw)"


def _to_physical_prototype(message: MessageSpec, signal: SignalSpec) -> str:
    return f"double {to_physical_name(message, signal)}({c_type(signal)} raw)"


def physical_header(protocol: ProtocolSpec) -> str:
    """Text of `softbot_physical.h`. Raises SpecError for a scaled signal too long for a double."""
    lines = [
        GENERATED,
        "#ifndef SOFTBOT_PHYSICAL_H",
        "#define SOFTBOT_PHYSICAL_H",
        "",
        "#include <stdbool.h>",
        "#include <stdint.h>",
        "",
        "/*",
        " * Raw counts from physical values and back, in IEEE 754 double precision. To raw: to the nearest, ties to",
        " * even; false, and nothing written, for what is not finite or out of range; a measurement (SaturatedNumber)",
        " * out of range gives the end of its range. Signals that are not here have their unit as raw count.",
        " */",
        "",
    ]
    for message, signal in _scaled(protocol):
        lines.append(f"{_to_raw_prototype(message, signal)};")
        lines.append(f"{_to_physical_prototype(message, signal)};")
    return "\n".join([*lines, "", "#endif", ""])


def physical_source(protocol: ProtocolSpec) -> str:
    """Text of `softbot_physical.c`. Raises SpecError for a scaled signal too long for a double."""
    lines = [GENERATED, '#include "softbot_physical.h"', "", "#include <float.h>", ""]
    lines += _PHYSICAL_FUNCTIONS.replace("SLACK_STEPS", repr(RANGE_SLACK_STEPS)).splitlines()
    for message, signal in _scaled(protocol):
        lines += _accessors(message, signal)
    return "\n".join(lines)


_PHYSICAL_FUNCTIONS = """
typedef struct {
    double scale;
    double offset;
    int64_t minimum;
    int64_t maximum;
    bool saturated;
} scaling_t;

/* To the nearest, ties to even; `steps` lies within the range of a signal, where every conversion here is exact. */
static int64_t rounded(double steps)
{
    int64_t whole = (int64_t)steps;
    const double rest = steps - (double)whole;
    const bool odd = (whole % 2) != 0;
    if ((rest > 0.5) || (odd && (rest >= 0.5))) {
        whole += 1;
    } else if ((rest < -0.5) || (odd && (rest <= -0.5))) {
        whole -= 1;
    } else {
        /* nearest already */
    }
    return whole;
}

static bool to_raw(const scaling_t *scaling, double physical, int64_t *raw)
{
    const double shifted = physical - scaling->offset;
    const double steps = shifted / scaling->scale;
    bool accepted = (steps >= -DBL_MAX) && (steps <= DBL_MAX); /* neither infinite nor NaN */
    if (accepted) {
        /* the slack lets every decoded value be encoded again */
        if (steps < ((double)scaling->minimum - SLACK_STEPS)) {
            *raw = scaling->minimum;
            accepted = scaling->saturated;
        } else if (steps > ((double)scaling->maximum + SLACK_STEPS)) {
            *raw = scaling->maximum;
            accepted = scaling->saturated;
        } else {
            *raw = rounded(steps);
        }
    }
    return accepted;
}

/* In two statements: a compiler may contract one into a fused multiply-add, which rounds otherwise. */
static double to_physical(const scaling_t *scaling, int64_t raw)
{
    const double product = (double)raw * scaling->scale;
    return product + scaling->offset;
}

"""


def _accessors(message: MessageSpec, signal: SignalSpec) -> list[str]:
    scaling = f"{snake_case(message.name)}_{snake_case(signal.name)}"
    saturated = signal.kind is SignalKind.SATURATED_NUMBER
    return [
        f"static const scaling_t {scaling} = {{",
        f"    .scale = {float(signal.scale)!r},",
        f"    .offset = {float(signal.offset)!r},",
        f"    .minimum = {signal.raw_minimum},",
        f"    .maximum = {signal.raw_maximum},",
        f"    .saturated = {'true' if saturated else 'false'},",
        "};",
        "",
        _to_raw_prototype(message, signal),
        "{",
        "    int64_t wide = 0;",
        f"    const bool accepted = to_raw(&{scaling}, physical, &wide);",
        "    if (accepted) {",
        f"        *raw = ({c_type(signal)})wide;",
        "    }",
        "    return accepted;",
        "}",
        "",
        _to_physical_prototype(message, signal),
        "{",
        f"    return to_physical(&{scaling}, raw);",
        "}",
        "",
    ]
