"""Does a table make sense: units, signs, gauge or absolute, copies."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from calib.bend_table import BendTable
from softbot.cross_section import CHAMBER_ANGLES_RAD
from softbot.errors import InputError

ATMOSPHERE_PA = 101_325.0


def checked(table: BendTable) -> BendTable:
    """The table, signs settled, copies removed. Raises InputError for what no robot can have measured."""
    table = _without_copies(table)
    if len(table) < 2:
        raise InputError(f"{table.source}: one row is not enough; measure the bend at two pressures or more")
    if not np.any(table.loading):
        raise InputError(f"{table.source}: only unloading rows; the law is fitted to rows of rising pressure, add them")
    _check_pressures(table)
    table = _check_bends(table)
    _check_absolute(table)
    _check_lengths(table)
    return table


def _where(table: BendTable, row: int) -> str:
    return f"{table.source}, line {table.line[row]}"


def _without_copies(table: BendTable) -> BendTable:
    """Rows that equal another in every cell carry nothing new (a repeat differs at least in its trial)."""
    columns = [table.bend_rad, table.direction_rad, table.length_m, table.loading, table.trial, table.setpoint]
    keys = [*table.pressure_Pa.T, *columns]
    order = np.lexsort([np.unique(key, return_inverse=True)[1] for key in keys])
    first = np.ones(len(table), dtype=bool)  # of its equals, which stand together in this order
    first[1:] = np.any([_differ(key[order[1:]], key[order[:-1]]) for key in keys], axis=0)
    copies = len(table) - int(np.sum(first))
    if not copies:
        return table
    note = f"{copies} row{'s' if copies > 1 else ''} that repeat another to the last digit left out"
    return replace(table.rows(np.sort(order[first])), notes=(*table.notes, note))


def _differ(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return (one != other) & ((one == one) | (other == other))  # NaN equals NaN here


def _check_pressures(table: BendTable) -> None:
    pressure = table.pressure_Pa
    largest = float(np.max(pressure))
    if largest > 1e7:
        row = int(np.argmax(np.max(pressure, axis=1)))
        raise InputError(
            f"{_where(table, row)}: a pressure of {largest / 1e6:.4g} MPa; soft robots live "
            "below 10 MPa: check the unit in the header"
        )
    lowest = float(np.min(pressure))
    if lowest < -max(2e3, 0.03 * abs(largest)):
        row = int(np.argmin(np.min(pressure, axis=1)))
        raise InputError(
            f"{_where(table, row)}: a pressure of {lowest / 1e3:.4g} kPa; chambers are pressurised above the "
            "atmosphere: is the column a mix of gauge and absolute pressure? Give gauge pressures throughout"
        )
    if np.all(np.ptp(pressure, axis=0) <= 1e-3 * max(largest, 1.0)):
        raise InputError(
            f"{table.source}: the pressure never changes ({largest / 1e3:.4g} kPa); measure at several pressures"
        )
    if largest < 500.0:
        raise InputError(
            f"{table.source}: no pressure above {largest:.3g} Pa; that bends no robot: check the unit in the header"
        )


def _check_bends(table: BendTable) -> BendTable:
    bend = table.bend_rad
    largest = float(np.max(np.abs(bend)))
    if largest > math.radians(720.0):
        row = int(np.argmax(np.abs(bend)))
        raise InputError(
            f"{_where(table, row)}: a bend of {math.degrees(largest):.4g}°, over two full turns; "
            "check the unit in the header"
        )
    if largest < math.radians(1.0):
        raise InputError(
            f"{table.source}: the bend never exceeds {math.degrees(largest):.3g}°; check the unit in the "
            "header (radians called degrees?) and that the column is the bend"
        )
    directed = np.isfinite(table.direction_rad)
    noise = 0.05 * largest
    negative = (bend < -noise) & ~directed
    if np.any(negative):
        if np.any(bend[~directed] > noise):
            row = int(np.argmax(negative))
            raise InputError(
                f"{_where(table, row)}: a negative bend; bends in two directions need bend_direction_deg "
                "(towards the centre of curvature, 0° at chamber 0, 90° at chamber 1) and positive bends"
            )
        table = replace(
            table,
            bend_rad=np.where(directed, bend, -bend),
            notes=(*table.notes, "all bends are negative: their sizes are taken"),
        )
    turned = directed & (bend < 0.0)  # a negative size is a bend the other way
    return replace(
        table,
        bend_rad=np.where(turned, -table.bend_rad, table.bend_rad),
        direction_rad=np.where(turned, table.direction_rad + math.pi, table.direction_rad),
    )


def _check_absolute(table: BendTable) -> None:
    """A column that starts at the atmosphere with a straight robot is absolute pressure."""
    used = table.pressure_Pa[:, np.max(table.pressure_Pa, axis=0) > 0.0]
    if used.size == 0:
        return
    lowest = float(np.min(used))
    if not 0.93 * ATMOSPHERE_PA <= lowest <= 1.05 * ATMOSPHERE_PA:
        return
    straight = table.bend_rad[np.argmin(np.sum(used, axis=1))]
    if straight < 0.1 * np.max(table.bend_rad):
        raise InputError(
            f"{table.source}: the robot is straight at {lowest / 1e3:.4g} kPa: these are absolute pressures; "
            "name the column pressure_absolute_kPa, or take the atmosphere off"
        )


def _check_lengths(table: BendTable) -> None:
    length = table.length_m[np.isfinite(table.length_m)]
    if length.size == 0:
        return
    for row in np.flatnonzero(np.isfinite(table.length_m)):
        if not 1e-3 <= table.length_m[row] <= 100.0:
            raise InputError(
                f"{_where(table, int(row))}: a length of {table.length_m[row]:.4g} m; check the unit in the header"
            )
    if np.max(length) > 5.0 * np.min(length):
        raise InputError(
            f"{table.source}: lengths from {np.min(length):.4g} m to {np.max(length):.4g} m; no tube "
            "stretches five times: check for mixed units"
        )


def check_response(table: BendTable) -> list[str]:
    """Do the bends follow the pressures at all? Warnings in words.

    Raises InputError when the bend falls as the pressure rises, and when the directions are turned or mirrored against
    the chambers.
    """
    angle = np.array(CHAMBER_ANGLES_RAD)
    expected = -table.pressure_Pa @ np.column_stack([np.cos(angle), np.sin(angle)])
    net_Pa = np.hypot(*expected.T)
    if float(np.ptp(net_Pa)) > 0.3 * float(np.max(net_Pa)):
        rank_pressure, rank_bend = (
            np.argsort(np.argsort(values, kind="stable")) for values in (net_Pa, table.bend_rad)
        )
        together = np.sum((rank_pressure - rank_pressure.mean()) * (rank_bend - rank_bend.mean()))
        if together < 0.0 or float(np.ptp(table.bend_rad)) < 1e-6 * float(np.max(table.bend_rad)):
            raise InputError(
                f"{table.source}: the bend does not rise with the pressure; are the columns swapped, or pressures "
                "of another chamber?"
            )
    strong = np.isfinite(table.direction_rad) & (net_Pa > 0.3 * np.max(net_Pa))
    if not np.any(strong):
        return []
    weight = table.bend_rad[strong] / np.sum(table.bend_rad[strong])
    measured, wanted = table.direction_rad[strong], np.arctan2(expected[strong, 1], expected[strong, 0])
    turned = np.sum(weight * np.exp(1j * (measured - wanted)))
    mirrored = np.sum(weight * np.exp(1j * (measured + wanted)))
    offset_deg = math.degrees(float(np.angle(turned)))
    convention = (
        "the direction points to the centre of curvature, away from the chamber that has pressure; 0° is at "
        "chamber 0, 90° at chamber 1"
    )
    if abs(turned) > 0.7 and abs(offset_deg) > 45.0:
        raise InputError(
            f"{table.source}: the bend directions are turned by {offset_deg:.0f}° against the chambers: {convention}"
        )
    if abs(turned) < 0.5:
        how = "are mirrored against" if abs(mirrored) > 0.7 else "do not follow"
        raise InputError(f"{table.source}: the bend directions {how} the chambers: {convention}")
    if abs(offset_deg) > 5.0:
        return [f"the bend directions are turned by {offset_deg:.1f}° against the chambers; the law knows no such turn"]
    return []
