"""`softbot parameters`: the valve board's parameters, read and lowered over the bus."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from softbot.cli.options import Channel, Interface, Json

if TYPE_CHECKING:
    from firmware_protocol.enumerations import Parameter


def parameters(
    assignments: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME=VALUE]...", help="Limits to lower, in the unit that is shown.")
    ] = None,
    interface: Interface = "socketcan",
    channel: Channel = "vcan0",
    json: Json = False,
) -> None:
    """Show the valve board's parameters, and lower its limits.

    No limit can be raised over the bus: what was lowered holds until the board is powered up again. Speaks as the
    sequencer, so none may run beside it.
    """
    import json as json_format

    from rich.console import Console
    from rich.table import Table

    from firmware_protocol.parameters import PARAMETERS
    from softbot.errors import InputError
    from softbot.nodes.parameters import board_parameters

    found = board_parameters(interface, channel, dict(assigned(text) for text in assignments or ()))
    if json:
        told = {
            "mode": found.mode.name.lower(),
            "parameters": {each.name.lower(): value for each, value in found.values.items()},
            "refused": {each.name.lower(): why for each, why in found.refused.items()},
        }
        typer.echo(json_format.dumps(told))
    else:
        table = Table("parameter", "value", "unit", "can be lowered to", "meaning", box=None)
        for each in PARAMETERS:
            least = "" if each.minimum is None else str(each.minimum)
            name, value = each.parameter.name.lower(), found.values.get(each.parameter)
            table.add_row(name, "?" if value is None else str(value), each.unit, least, each.meaning)
        Console(width=110).print(table)
    if found.refused:
        raise InputError("; ".join(f"{each.name.lower()} was refused: {why}" for each, why in found.refused.items()))


def assigned(text: str) -> tuple[Parameter, int]:
    """A parameter and its value from `name=value`. Raises InputError."""
    from firmware_protocol.enumerations import Parameter
    from softbot.errors import InputError

    name, _, value = text.partition("=")
    known = ", ".join(each.name.lower() for each in Parameter)
    if name.upper() not in Parameter.__members__:
        raise InputError(f"{text!r}: {name!r} is no parameter of the board; choose one of: {known}")
    if not value.isdecimal() or int(value) > 0xFFFFFFFF:
        raise InputError(
            f"{text!r}: give a whole number from 0 to 4294967295, in the unit that `softbot parameters` shows"
        )
    return Parameter[name.upper()], int(value)
