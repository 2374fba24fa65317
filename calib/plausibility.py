"""Does a table make sense: units, signs, gauge or absolute, copies."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from calib.bend_table import BendTable
from softbot.cross_section import CHAMBER_ANGLES_RAD
from softbot.errors import InputError

ATMOSPHERE_PA = 101_325.0
_LOW_PRESSURE = 0.25  # of the largest: there a bend may be anything
_UNIT_RATIOS = {
    "kPa to psi": 6.894757,
    "kPa to bar": 100.0,
    "kPa to MPa or Pa to kPa": 1000.0,
    "degrees to radians": 180.0 / math.pi,
    "psi to bar": 14.50377,
}


def checked(table: BendTable) -> BendTable:
    """The table, signs settled, copies removed. Raises InputError for what no robot can have measured."""
    table = _without_copies(_measured(table))
    if len(table) < 2:
        raise InputError(f"{table.source}: one row is not enough; measure the bend at two pressures or more")
    if not np.any(table.loading):
        raise InputError(f"{table.source}: only unloading rows; the law is fitted to rows of rising pressure, add them")
    _check_pressures(table)
    table = _check_bends(table)
    _check_absolute(table)
    return _check_lengths(table)


def _where(table: BendTable, row: int) -> str:
    return table.place(row)


def _measured(table: BendTable) -> BendTable:
    """The rows whose bend was measured well. Raises InputError where a bend is missing without being flagged."""
    missing = table.valid & ~np.isfinite(table.bend_rad)
    if np.any(missing):
        raise InputError(
            f"{table.place(int(np.argmax(missing)))}: no bend; fill it in, remove the {table.row_word}, or add a "
            "column valid with 0 there"
        )
    bad = int(np.sum(~table.valid))
    if not bad:
        return table
    return replace(table.rows(table.valid), notes=(*table.notes, f"{bad} rows flagged as not valid left out"))


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
            signed = _both_ways(table)
            if signed is None:
                row = int(np.argmax(negative))
                raise InputError(
                    f"{_where(table, row)}: a negative bend; bends in two directions need bend_direction_deg "
                    "(towards the centre of curvature, 0° at chamber 0, 90° at chamber 1) and positive bends, or the "
                    "pressures of two opposite chambers, whose difference has the sign of the bend throughout"
                )
            return signed
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


def _both_ways(table: BendTable) -> BendTable | None:
    """A table of signed bends by two opposite chambers, with directions; None where the signs do not follow them."""
    largest_Pa = float(np.max(table.pressure_Pa))
    driven = np.flatnonzero(np.max(table.pressure_Pa, axis=0) > 0.2 * largest_Pa)
    if len(driven) != 2 or driven[1] - driven[0] != 2 or np.any(np.isfinite(table.direction_rad)):
        return None
    one, other = int(driven[0]), int(driven[1])
    net_Pa = table.pressure_Pa[:, one] - table.pressure_Pa[:, other]
    clear = (np.abs(net_Pa) > 0.2 * largest_Pa) & (np.abs(table.bend_rad) > 0.1 * np.max(np.abs(table.bend_rad)))
    signs = np.sign(net_Pa[clear] * table.bend_rad[clear])
    if len(np.unique(signs)) != 1:
        return None
    towards = CHAMBER_ANGLES_RAD[other], CHAMBER_ANGLES_RAD[one]  # a chamber that has pressure bends away from itself
    positive = towards if signs[0] > 0 else towards[::-1]
    return replace(
        table,
        bend_rad=np.abs(table.bend_rad),
        direction_rad=np.where(table.bend_rad >= 0.0, positive[0], positive[1]),
        notes=(
            *table.notes,
            f"signed bends: a positive one is by chamber {one if signs[0] > 0 else other}, a negative one by "
            f"chamber {other if signs[0] > 0 else one}",
        ),
    )


def _check_absolute(table: BendTable) -> None:
    """A column that starts at the atmosphere with a straight robot is absolute pressure."""
    used = table.pressure_Pa[:, np.max(table.pressure_Pa, axis=0) > 0.0]
    if used.size == 0 or table.gauge_stated:
        return
    lowest = float(np.min(used))
    if not 0.8 * ATMOSPHERE_PA <= lowest <= 1.05 * ATMOSPHERE_PA:
        return
    straight = table.bend_rad[np.argmin(np.sum(used, axis=1))]
    if straight < 0.05 * np.max(table.bend_rad):
        raise looks_absolute(table, f"the robot is straight at {lowest / 1e3:.4g} kPa")


def looks_absolute(table: BendTable, why: str) -> InputError:
    """The refusal of absolute pressures in a column that does not say so."""
    return InputError(
        f"{table.source}: {why}: these look like absolute pressures; name the column pressure_absolute_kPa or take the "
        "atmosphere off (if they are gauge pressures after all, name it pressure_gauge_kPa)"
    )


def _check_lengths(table: BendTable) -> BendTable:
    length = table.length_m[np.isfinite(table.length_m)]
    if length.size == 0:
        return table
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
    if length.size > 1 and np.ptp(length) <= 1e-6 * np.max(length):
        return replace(
            table,
            length_m=np.full(len(table), np.nan),
            rest_length_m=float(length[0]),
            notes=(*table.notes, f"the length is {length[0]:.4g} m in every row: taken as the length at rest"),
        )
    return table


def _check_one_unit(table: BendTable) -> None:
    """Rows in another unit than the rest: two clouds of bend per pressure, apart by the ratio of two units."""
    angle = np.array(CHAMBER_ANGLES_RAD)
    net_Pa = np.hypot(*(table.pressure_Pa @ np.column_stack([np.cos(angle), np.sin(angle)])).T)
    bend = table.bend_rad
    one_sided = net_Pa > 0.2 * np.max(table.pressure_Pa, axis=1)  # others bend by small differences
    rows = np.flatnonzero(one_sided & (net_Pa > 0.02 * np.median(net_Pa)) & (bend > 0.005 * np.max(bend)))
    if len(rows) < 5 or rank_correlation(net_Pa[rows], bend[rows]) > 0.9:
        return
    slope = np.log(bend[rows] / net_Pa[rows])
    order = np.argsort(slope)
    gap = int(np.argmax(np.diff(slope[order])))
    flat, steep = order[: gap + 1], order[gap + 1 :]
    apart = float(np.median(slope[steep]) - np.median(slope[flat]))
    pair, ratio = min(_UNIT_RATIOS.items(), key=lambda one: abs(math.log(one[1]) - apart))
    if abs(apart - math.log(ratio)) > 0.25 * math.log(ratio):
        return
    if np.max(net_Pa[rows][flat]) < _LOW_PRESSURE * np.max(net_Pa):
        return  # hardly any bend where it begins: a dead band, and noise
    odd = min(flat, steep, key=len)
    mended = net_Pa[rows].copy()
    mended[steep] *= ratio
    if rank_correlation(mended, bend[rows]) > 0.95:
        row = int(rows[np.min(odd)])
        raise InputError(
            f"{table.place(row)}: here the bend per pressure is {math.exp(apart):.3g} times "
            f"{'greater' if odd is steep else 'smaller'} than in most rows, about the ratio of {pair} "
            f"({len(odd)} such rows): put all rows into the unit of the header"
        )


def off_angle_rad(table: BendTable) -> float:
    """By how much the bends of one chamber, the worst, lie off the direction that is its own, on average [rad]."""
    worst = 0.0
    for i, angle in enumerate(CHAMBER_ANGLES_RAD):
        others = np.delete(table.pressure_Pa, i, axis=1)
        alone = np.isfinite(table.direction_rad) & (table.pressure_Pa[:, i] > 3.0 * np.max(others, axis=1))
        alone &= table.bend_rad > 0.2 * np.max(table.bend_rad)
        if np.any(alone):
            off = np.exp(1j * (table.direction_rad[alone] - angle - math.pi))
            worst = max(worst, abs(float(np.angle(np.sum(table.bend_rad[alone] * off)))))
    return worst


def rank_correlation(one: np.ndarray, other: np.ndarray) -> float:
    """Spearman's, without a correction for ties; 0 where one does not change."""
    ranks = [np.unique(values, return_inverse=True)[1].astype(float) for values in (one, other)]
    centred = [rank - rank.mean() for rank in ranks]
    size = math.sqrt(float(np.sum(centred[0] ** 2) * np.sum(centred[1] ** 2)))
    return float(centred[0] @ centred[1]) / size if size > 0.0 else 0.0


def check_response(table: BendTable) -> list[str]:
    """Do the bends follow the pressures at all? Warnings in words.

    Raises InputError when the bend falls as the pressure rises, and when the directions are turned or mirrored against
    the chambers.
    """
    _check_one_unit(table)
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
        return [
            f"the bend directions are turned by {offset_deg:.1f}° against the chambers: are these askew, or the camera?"
        ]
    return []
