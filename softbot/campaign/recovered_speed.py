"""How fast a damaged robot rolls on, over how fast the sound one rolls: by pneumatic lag, lead and what is left.

    python -m softbot.campaign.recovered_speed        the tables of docs/decisions/0030-planned-recovery.md

The shipped robot, at full effort but for the last table; its valves and the board's limit on the set-points' motion
are scaled, so that the chambers follow faster or slower. What is damaged is a chamber ruptured, or ballooning (a weak
chamber), or two ruptured in the same moment; detection is the sequencer's own. At full effort pressure sensors are told
to be noisier than the shipped ones: with the fastest valves the detector otherwise takes a chamber's own motion for
noise.

A weak chamber is compared with the same one dead in longer runs, once both have come to their speed, and over several
onsets, each with a seed of its own: which revolution a fault meets decides how it is named, and so how the robot rolls.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.interface import STATES, SequencerState
from sim.scene import scene_from
from softbot.campaign.outcome import longest_still_s, mean_rate
from softbot.faults import Fault, FaultKind
from softbot.nodes.direct import TRACE, DirectRun
from softbot.nodes.valve_loop import designed_gains
from softbot.robot import load_robot

FloatArray = NDArray[np.float64]

VALVES = (2.4, 1.0, 0.7, 0.5, 0.4)
"""Conductance over the shipped robot's."""
NOISE_Pa = 1500.0
LEADS_RAD = (0.5, 0.8, 1.57)
STRUCK_S, SETTLED_S, END_S = 4.0, 7.0, 20.0
STEADY_S, LONG_S = 10.0, 40.0
ORDERED_REV_S = (0.1, 0.2, 0.4, 0.8)
ONSETS, ONSET_S = 4, 0.13
"""Onsets of what is compared with its standard error, and the time between them."""
PAIRS = ((0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3))
WEAK = (0.3, 0.6, 1.0)
"""Severities of a ballooning chamber."""
_CYCLE_S = 0.01
_ROLL, _STATE = TRACE.index("roll_rad"), TRACE.index("state")
_PRESSURE, _SETPOINT = (
    slice(TRACE.index(f"{name}_0_Pa"), TRACE.index(f"{name}_0_Pa") + 4) for name in ("pressure", "setpoint")
)


@dataclass(frozen=True)
class Rolled:
    """What became of one run."""

    rate_rev_s: float
    """In the ordered direction, after the robot has had time to find what is wrong."""
    lag_s: float
    """In which the first chamber came to 1 − 1/e of the first set-point."""
    longest_still_s: float
    highest_pressure_Pa: float
    ended_safe: bool


def rolled(
    valves: float,
    lead_rad: float,
    faults: Iterable[Fault] = (),
    *,
    command: str = "left",
    speed_rev_s: float | None = None,
    pressure_noise_Pa: float = NOISE_Pa,
    seed: int = 0,
    settled_s: float = SETTLED_S,
    end_s: float = END_S,
) -> Rolled:
    """Roll the shipped robot with valves so many times as large. Raises SimulationError.

    speed_rev_s: ordered; None: full effort. settled_s: from when its speed counts; end_s: how long it rolls.
    """
    gas = load_robot("default").pneumatics
    conductances = {
        "supply_valve_conductance_m3_s_Pa": [valves * one for one in gas.supply_valve_conductance_m3_s_Pa],
        "exhaust_valve_conductance_m3_s_Pa": [valves * one for one in gas.exhaust_valve_conductance_m3_s_Pa],
        "regulator_conductance_m3_s_Pa": max(valves, 1.0) * gas.regulator_conductance_m3_s_Pa,
    }
    tables: dict[str, Any] = {
        "robot": "default",
        "drive": {"kind": "sequencer"},
        "sequencer": {"command": command, "lead_rad": lead_rad, "speed_rev_s": speed_rev_s},
        "fault": [
            {"t_s": one.t_s, "kind": str(one.kind), "chamber": one.chamber, "severity": one.severity} for one in faults
        ],
        "solver": {"twin": "rod", "accuracy": "fast", "duration_s": end_s, "seed": seed},
    }
    scaled = [f"robot.pneumatics.{key}={value}" for key, value in conductances.items()]
    scene = scene_from(
        tables, "recovered_speed", Path(), (*scaled, f"robot.sensors.pressure_noise_Pa={pressure_noise_Pa}")
    )
    gains = designed_gains(scene.robot)
    gains = replace(gains, setpoint_rate_Pa_s=valves * gains.setpoint_rate_Pa_s)
    trace = DirectRun(scene, gains=gains).advance(round(end_s / _CYCLE_S)).trace
    turns = (-1.0 if command == "left" else 1.0) * trace[:, _ROLL] / (2.0 * math.pi)
    return Rolled(
        mean_rate(trace[:, 0], turns, settled_s, math.inf) or 0.0,
        _lag_s(trace),
        longest_still_s(trace[:, 0], turns, STRUCK_S) or 0.0,
        float(trace[:, _PRESSURE].max()),
        STATES[int(trace[-1, _STATE])] is SequencerState.SAFE,
    )


def _lag_s(trace: FloatArray) -> float:
    begins = int(np.argmax(trace[:, _SETPOINT].max(axis=1) > 0.0))
    chamber = int(np.argmax(trace[begins, _SETPOINT]))
    first = trace[begins, _SETPOINT][chamber]
    followed = trace[begins:, _PRESSURE][:, chamber] > -math.expm1(-1.0) * first
    return _CYCLE_S * int(np.argmax(followed))


def struck(
    chambers: Iterable[int], kind: FaultKind = FaultKind.RUPTURE, severity: float = 1.0, later_s: float = 0.0
) -> tuple[Fault, ...]:
    """Something that befalls these chambers in the same moment."""
    return tuple(Fault(STRUCK_S + later_s, chamber, kind, severity) for chamber in chambers)


def speeds_rev_s(valves: float, lead_rad: float, kind: FaultKind, severity: float = 1.0) -> FloatArray:
    """Steady speeds with each chamber struck in turn, shape (ONSETS, 4)."""
    return np.array(
        [
            [
                rolled(
                    valves,
                    lead_rad,
                    struck([chamber], kind, severity, ONSET_S * onset),
                    seed=onset,
                    settled_s=STEADY_S,
                    end_s=LONG_S,
                ).rate_rev_s
                for chamber in range(4)
            ]
            for onset in range(ONSETS)
        ]
    )


def weak_over_dead(valves: float, lead_rad: float) -> list[tuple[float, float]]:
    """For each of WEAK: speed with a weak chamber over that with the same one dead, and its standard error."""
    dead = speeds_rev_s(valves, lead_rad, FaultKind.RUPTURE).mean(axis=1)
    compared = []
    for severity in WEAK:
        shares = speeds_rev_s(valves, lead_rad, FaultKind.BALLOONING, severity).mean(axis=1) / dead
        compared.append((float(shares.mean()), float(shares.std(ddof=1) / math.sqrt(ONSETS))))
    return compared


def _held(pair: tuple[int, int], speed_rev_s: float) -> str:
    """Least and most of the speeds over the onsets with this pair dead, of the runs that were not stopped, in words."""
    runs = [
        rolled(
            1.0,
            0.8,
            struck(pair, later_s=ONSET_S * onset),
            speed_rev_s=speed_rev_s,
            pressure_noise_Pa=load_robot("default").sensors.pressure_noise_Pa,
            seed=onset,
            settled_s=STEADY_S,
            end_s=LONG_S,
        )
        for onset in range(ONSETS)
    ]
    rates = [one.rate_rev_s for one in runs if not one.ended_safe]
    stopped = len(runs) - len(rates)
    held = f"{min(rates):.2f} … {max(rates):.2f}" if rates else ""
    return held + (f" ({stopped} of {len(runs)} stopped safely)" if stopped else "")


def tables() -> str:
    """One dead, one weak and two dead chambers as Markdown tables."""
    sound = {(valves, lead): rolled(valves, lead) for valves in VALVES for lead in LEADS_RAD}
    lag_s = {valves: sound[valves, LEADS_RAD[0]].lag_s for valves in VALVES}
    head = "| lag [s] | lead [rad] | healthy [rev/s] | one dead, of healthy: least … most of four | "
    lines = [
        head + " | ".join(f"weak {severity:g}, of dead" for severity in WEAK) + " |",
        "|---" * (4 + len(WEAK)) + "|",
    ]
    for (valves, lead), healthy in sound.items():
        dead = [rolled(valves, lead, struck([chamber])).rate_rev_s for chamber in range(4)]
        shares = [one / healthy.rate_rev_s for one in dead]
        cells = [
            f"{lag_s[valves]:.2f}",
            f"{lead:g}",
            f"{healthy.rate_rev_s:.2f}",
            f"{min(shares):.2f} … {max(shares):.2f}",
        ]
        lines.append(
            "| "
            + " | ".join(cells + [f"{share:.2f} ± {error:.2f}" for share, error in weak_over_dead(valves, lead)])
            + " |"
        )
    lines += ["", "| two dead | " + " | ".join(f"lag {lag_s[valves]:.2f} s" for valves in VALVES) + " |"]
    lines.append("|---" * (1 + len(VALVES)) + "|")
    for pair in PAIRS:
        runs = [rolled(valves, 0.8, struck(pair)) for valves in VALVES]
        cells = ["stopped safely" if one.ended_safe else f"{one.rate_rev_s:.2f} rev/s" for one in runs]
        lines.append(f"| {pair[0]} and {pair[1]} | " + " | ".join(cells) + " |")
    lines += ["", "| two dead | " + " | ".join(f"ordered {speed:g} rev/s" for speed in ORDERED_REV_S) + " |"]
    lines.append("|---" * (1 + len(ORDERED_REV_S)) + "|")
    for pair in PAIRS:
        lines.append(f"| {pair[0]} and {pair[1]} | " + " | ".join(_held(pair, speed) for speed in ORDERED_REV_S) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(tables())
