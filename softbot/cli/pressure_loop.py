"""`softbot pressure-loop`: the gains of a robot's pressure loop and the margins they have."""

from __future__ import annotations

from typing import Annotated

import typer

from softbot.cli.options import Json


def pressure_loop(
    robot: Annotated[str, typer.Argument(metavar="ROBOT.toml", help="Robot file, or default.")] = "default",
    json: Json = False,
) -> None:
    """Design a robot's pressure loop.

    Prints the gains, and the margins at every operating point.
    """
    from softbot.cli.streams import messages

    with messages().status("designing the pressure loop"):
        from controllers.pressure_loop import DEFAULT_SETPOINT_RATE_Pa_s
        from softbot.nodes.valve_loop import design, half_open
        from softbot.robot import load_robot

        known = load_robot(robot)
        found = design(known)
        leaking = half_open(known, found.gains)
    if json:
        import json as json_format
        from dataclasses import asdict

        answer = {
            "gains": asdict(found.gains),
            "gain_margin_dB": found.gain_margin_dB,
            "phase_margin_deg": found.phase_margin_deg,
            "bandwidth_rad_s": found.bandwidth_rad_s,
            "stable": found.stable,
            "half_open": {
                "gain_margin_dB": leaking.gain_margin_dB,
                "phase_margin_deg": leaking.phase_margin_deg,
                "stable": leaking.stable,
            },
            "points": [asdict(point) for point in found.points],
        }
        typer.echo(json_format.dumps(answer))
        return
    typer.echo(found.table())
    typer.echo(
        f"worst: gain margin {found.gain_margin_dB:.1f} dB, phase margin {found.phase_margin_deg:.1f} deg; "
        f"bandwidth when holding at least {found.bandwidth_rad_s:.1f} rad/s; "
        f"{'stable everywhere' if found.stable else 'UNSTABLE somewhere'}"
    )
    if found.gains.setpoint_rate_Pa_s < DEFAULT_SETPOINT_RATE_Pa_s:
        typer.echo(
            f"valves that a large leak holds half open: gain margin {leaking.gain_margin_dB:.1f} dB, "
            f"phase margin {leaking.phase_margin_deg:.1f} deg"
        )
