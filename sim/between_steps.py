"""The rod between two steps: pose and shape as cubics that meet position and rate at both ends.

A steady roll takes steps of a tenth of a second, at which a picture of it jerks. In between, each coordinate of the rod
follows the cubic (Hermite) that its values and rates at both ends ask for, in axes that go with the tangent of the
middle but do not roll: there the bends of a steady roll stay where they are and roll itself is linear in time, so that
both are met to rounding. Pose, shape and their rates are continuous from step to step.

Left out: what a step was divided into. Where the rates do not fit the way that was gone (a blow in the middle of the
step), the way is gone evenly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.rod_memory import TIME, WORK, Instants

FloatArray = NDArray[np.float64]

_FITS = 1.0  # of the radius, and rad: more may a step not be off its rates


def fill_between(ends: Instants, between: Instants, modes: int, radius_m: float) -> None:
    """Fill `between`, axes (steps, count − 1, …), with where a rod was between each two of `ends`, (steps + 1, …).

    The instants part each step into `count` equal spans. The actuators' work is laid straight between the ends: it is
    known once a step. All flags but that and the time are those of the step's end.
    """
    start, end = Instants(*(part[:-1] for part in ends)), Instants(*(part[1:] for part in ends))
    span_s = (end.flag[:, TIME] - start.flag[:, TIME])[:, None]
    share = np.arange(1, between.flag.shape[1] + 1) / (between.flag.shape[1] + 1)
    way = end.position_m - start.position_m
    rates = span_s * start.velocity[:, :3], span_s * end.velocity[:, :3]
    astray = (np.abs(0.5 * (rates[0] + rates[1]) - way).max(axis=1) > _FITS * radius_m)[:, None]
    first_rate, last_rate = (np.where(astray, way, rate) for rate in rates)
    between.position_m[:], velocity = _cubic(start.position_m, end.position_m, first_rate, last_rate, share)
    first, last = start.rotation[:, :, 2], end.rotation[:, :, 2]
    first_rate, last_rate = (span_s * np.cross(one.velocity[:, 3:6], one.rotation[:, :, 2]) for one in (start, end))
    tangent, _ = _cubic(first, last, first_rate, last_rate, share)
    tangent /= np.sqrt(np.einsum("nmk,nmk->nm", tangent, tangent))[:, :, None]
    rolled, roll_rates = _roll(start, end, span_s[:, 0])
    astray = np.maximum(np.abs(roll_rates[0] - rolled), np.abs(roll_rates[1] - rolled)) > _FITS
    roll_rates = np.where(astray, rolled, roll_rates[0]), np.where(astray, rolled, roll_rates[1])
    roll, rolling = _cubic(
        np.zeros_like(span_s), rolled[:, None], roll_rates[0][:, None], roll_rates[1][:, None], share
    )
    between.rotation[:] = _carried(first, tangent) @ start.rotation[:, None] @ _turned(roll[:, :, 0])
    strain, gained = _cubic(
        start.strain, end.strain, span_s * start.velocity[:, 6:], span_s * end.velocity[:, 6:], share
    )
    _bends_in_space(start, end, span_s, modes, rolled, roll_rates, roll, rolling, share, strain, gained)
    between.strain[:] = strain
    between.velocity[:, :, :3] = velocity / span_s[:, None]
    between.velocity[:, :, 3:6] = straight(start.velocity[:, 3:6], end.velocity[:, 3:6], share)
    between.velocity[:, :, 6:] = gained / span_s[:, None]
    between.momentum[:] = straight(start.momentum, end.momentum, share)
    between.flag[:] = end.flag[:, None]
    for each in (TIME, WORK):
        between.flag[:, :, each] = straight(start.flag[:, each], end.flag[:, each], share)


def straight(start: NDArray, end: NDArray, share: FloatArray) -> NDArray:
    """Values at shares of the ways from `start` to `end`, (steps, …), straight: shape (steps, shares, …)."""
    s = share.reshape(-1, *(1,) * (start.ndim - 1))
    value: NDArray = start[:, None] + s * (end - start)[:, None]
    return value


def _cubic(
    start: NDArray, end: NDArray, rate_0: NDArray, rate_1: NDArray, share: FloatArray
) -> tuple[NDArray, NDArray]:
    """Values and rates at shares of the spans, shape (steps, shares, k) each; rates per span."""
    s = share[:, None]
    t, way = 1.0 - s, (end - start)[:, None]
    first, last = rate_0[:, None], rate_1[:, None]
    value = start[:, None] + s * s * (3.0 - 2.0 * s) * way + s * t * (t * first - s * last)
    rate = 6.0 * s * t * way + t * (1.0 - 3.0 * s) * first - s * (2.0 - 3.0 * s) * last
    return value, rate


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    product: FloatArray = np.einsum("nk,nk->n", a, b)
    return product


def _roll(start: Instants, end: Instants, span_s: FloatArray) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """Roll from start to end against axes that are carried along with the tangent [rad], its rates per span.

    Of the angles a whole turn apart it is the one that the rates ask for.
    """
    first, last = start.rotation[:, :, 2], end.rotation[:, :, 2]
    spin_0, spin_1 = start.velocity[:, 3:6], end.velocity[:, 3:6]
    # axes carried the shortest way from `first` roll a little where the tangent goes round it
    round_it = _dot(np.cross(last, np.cross(spin_1, last)), first) / (1.0 + _dot(first, last))
    rates = (span_s * _dot(spin_0, first), span_s * (_dot(spin_1, last) + round_it))
    carried = _carried(first, last[:, None])[:, 0] @ start.rotation
    left = np.swapaxes(carried, 1, 2) @ end.rotation
    angle = np.arctan2(left[:, 1, 0] - left[:, 0, 1], left[:, 0, 0] + left[:, 1, 1])
    turns = np.round((0.5 * (rates[0] + rates[1]) - angle) / (2.0 * np.pi))
    return angle + 2.0 * np.pi * turns, rates


def _bends_in_space(
    start: Instants, end: Instants, span_s: FloatArray, modes: int, rolled: FloatArray,
    roll_rates: tuple[FloatArray, FloatArray], roll: FloatArray, rolling: FloatArray, share: FloatArray,
    strain: FloatArray, gained: FloatArray,
) -> None:  # fmt: skip
    """Bends and what they gain in a span, at the shares: cubics in axes that do not roll, seen from those that do."""
    first, second = slice(0, 3 * modes, 3), slice(1, 3 * modes, 3)
    ends = []
    for one, angle, roll_rate in ((start, np.zeros_like(rolled), roll_rates[0]), (end, rolled, roll_rates[1])):
        rate = one.velocity[:, 6:]
        bend = one.strain[:, first] + 1j * one.strain[:, second]
        moving = rate[:, first] + 1j * rate[:, second]
        out = np.exp(1j * angle)[:, None]
        ends.append((out * bend, out * (span_s * moving + 1j * roll_rate[:, None] * bend)))
    (bend_0, rate_0), (bend_1, rate_1) = ends
    bend, rate = _cubic(bend_0, bend_1, rate_0, rate_1, share)
    back = np.exp(-1j * roll)
    bend, rate = bend * back, (rate - 1j * rolling * bend) * back
    strain[:, :, first], strain[:, :, second] = bend.real, bend.imag
    gained[:, :, first], gained[:, :, second] = rate.real, rate.imag


def _carried(first: FloatArray, tangent: FloatArray) -> FloatArray:
    """Rotations that take directions (n, 3) to others (n, m, 3) the shortest way, shape (n, m, 3, 3)."""
    x, y, z = np.moveaxis(np.cross(first[:, None], tangent), -1, 0)
    across = np.zeros((*tangent.shape, 3))
    across[..., 0, 1], across[..., 0, 2], across[..., 1, 2] = -z, y, -x
    across[..., 1, 0], across[..., 2, 0], across[..., 2, 1] = z, -y, x
    less = 1.0 + np.einsum("nmk,nk->nm", tangent, first)[:, :, None, None]
    rotation: FloatArray = np.eye(3) + across + across @ across / less
    return rotation


def _turned(angle_rad: FloatArray) -> FloatArray:
    """Turns about the tangent, in the section's axes, shape (…, 3, 3)."""
    turned = np.zeros((*angle_rad.shape, 3, 3))
    turned[..., 0, 0] = turned[..., 1, 1] = np.cos(angle_rad)
    turned[..., 1, 0] = np.sin(angle_rad)
    turned[..., 0, 1] = -turned[..., 1, 0]
    turned[..., 2, 2] = 1.0
    return turned
