"""Kinematics, inertia and the implicit step of the reduced-order rod (plain arrays, compiled, no allocation).

The rod: a Kirchhoff tube, base pose (x, Q0) at its mid cross-section, rotation per reference length w = (−k2, k1,
twist) in the section's axes as a sum of modes ψ_m, and (where it stretches) one uniform stretch ℓ:

    Q' = Q [w]×,   r' = ℓ t,   t = Q e3           by a Magnus step between points, by spectral integration
    ω' = Q ẇ,      v' = ℓ̇ t + ℓ ω × t            so the velocities are linear in u = (ẋ, ω0, modes' rates, ℓ̇),

all in world axes, relative to the middle. With A_m = ∫Q ψ_m ds and B_m = ∫ψ_m r × Q ds a mode's columns are
∂ω = A_m and ∂v = A_m × r + B_m. Each point carries its mass µ and the cross-section's rotary inertia
µ(R²/4)(1 + t tᵀ), so its inertia is the sum of squares of 7 rows: √µ v, √µ(R/2) ω, √µ(R/2) t·ω. With all rows of all
points as columns of G, the mass matrix is Gᵀ G; a linear damper or spring of a contact is one more row.

One step of length h finds the velocity gained, Δ, with G and the accelerations at u̇ = 0, b, at the middle of the step
as u foretells it, and all that is stiff (strain, damping, contact) taken implicitly:

    (GᵀG + hθC + h²θ²K + contact) Δ = −h Gᵀb − hK(q + θhu − q_rest) − hCu + contact,
    ū = u + θΔ,   u⁺ = u + Δ,   q⁺ = q + hū,   Q0⁺ = exp(hω̄) Q0

θ is each coordinate's own: ½ where the step resolves its natural motion (then the method is of second order), towards 1
where it does not (then it is damped out instead of rung); θ − ½ falls with h². b is quadratic in the velocity: where it
has changed by more than is negligible it is taken again with ū, and the same factors solve again. Contacts that the
solution contradicts are mended and solved again (`sim.rod_contact`). A step that turns or bends the rod too far to be
trusted is halved, and so is, under a tolerance, one whose error is too large.

When nothing touches, the velocity of the base that moves the rod follows from the momentum itself, which is so kept to
round-off: this turns the floating robot.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.motion_rows import ROW_SIZE
from sim.rod_algebra import (
    add_scaled,
    combine_rows,
    copy_into,
    dot,
    factorise,
    gather,
    gram,
    solve_backward,
    solve_forward,
)
from sim.rod_compile import FAST_MATH, inner
from sim.rod_contact import contact_rows, contradicted, drop_contacts, find_contacts, keep_contacts
from sim.rod_drive import growing_step_s, quiet_until_s, rest_curvature
from sim.rod_energy import audit_energy, elastic_energy_J
from sim.rod_forces import accelerations, elastic_forces, push, set_theta, softening, strain_forces
from sim.rod_memory import (
    ADVICE,
    ALOFT,
    ASLEEP,
    AUDITED,
    RESTED,
    SOLVES,
    STEPS,
    TIME,
    WORK,
    Contacts,
    Layout,
    Physics,
    State,
    Work,
    carve,
)
from sim.rod_momentum import base_that_keeps_momentum, outside_impulse, take_momentum
from sim.rod_placement import place_rod
from sim.rod_rotation import advance_rotation, bend_on, carry_bends, carry_spin, roll_rate, turn_gain
from sim.rod_row import note_kink, write_row
from sim.rod_rule import Rule
from sim.rod_views import flat, flat_rows
from softbot.kernel_compiler import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_LARGEST_SPEED = 1e8  # m/s, rad/s, rad/(m s): beyond, the state means nothing
_PASSES = 4  # of one step, at most
_AGAIN = 1e-4  # b is taken again when its change is more than this share of the velocity
_LARGEST_TURN = 0.32  # rad in a step, of the tangent in the middle: 20 steps a turn
_LARGEST_ROLL = 0.8  # rad in a step, about that tangent
_LARGEST_BEND = 1.0  # rad in a step, from end to end
_LARGEST_SWING = 0.5  # turn of the velocity in a step, by inertia alone
_LARGEST_STRETCH = 0.3  # in a step
_LARGEST_LIFT = 0.01  # of the radius, in a step
_LEAST_STRETCH = 0.1
_WAKING = 0.125  # of a step: the first one of a robot that slept
_HALVINGS = 14
_REST_TIME_S = 0.1

_AUDIT_STEPS = 16  # from one audit of the energy to the next, where steps are neither divided
_EASY_SOLVES = 2.0  # nor solved more often than so


@inner
def _missed(rate: FloatArray, change: FloatArray, foretold: FloatArray) -> float:
    """|G(u + Δ/2) − what was foretold of it|²."""
    x, y, z = flat(rate), flat(change), flat(foretold)
    total = 0.0
    for k in range(x.shape[0]):
        total += (x[k] + 0.5 * y[k] - z[k]) ** 2
    return total


@inner
def _trusted(
    h: float, length_m: float, radius_m: float, modes: int, stretch: float, touching: bool, rolling: float,
    vector: FloatArray, mean: FloatArray, column: FloatArray, theta: FloatArray, strain: FloatArray,
) -> int:  # fmt: skip
    """0: the step may stand; 1: it turns, bends or stretches the rod too far; 2: it is not finite.

    rolling: of the middle about its tangent; bends that only go round with it are none. strain: half-way.
    """
    gained = 0.0  # of the base's ω
    for d in range(vector.shape[0]):
        f = int(column[d])
        if not (abs(vector[d]) < _LARGEST_SPEED and abs(mean[f]) < _LARGEST_SPEED):
            return 2
        if 3 <= f < 6:
            gained += vector[d] * vector[d]
    turned = mean[3] ** 2 + mean[4] ** 2 + mean[5] ** 2 - rolling * rolling
    if h * h * turned > _LARGEST_TURN * _LARGEST_TURN or h * abs(rolling) > _LARGEST_ROLL:
        return 1
    bend = 0.0
    for a in range(0, 3 * modes, 3):
        bend += abs(mean[6 + a] - rolling * strain[a + 1]) + abs(mean[7 + a] + rolling * strain[a]) + abs(mean[8 + a])
    if h * length_m * bend > _LARGEST_BEND:
        return 1
    if mean.shape[0] > 6 + 3 * modes and abs(h * mean[6 + 3 * modes]) > _LARGEST_STRETCH * stretch:
        return 1
    if touching:  # what lies flat rolls and bends at once: where these have θ of their own it leaves the ground
        arch = 0.125 * length_m * min(length_m * np.sqrt(strain[0] * strain[0] + strain[1] * strain[1]), 4.0)
        if h * abs(theta[3] - theta[6]) * np.sqrt(gained) * arch > _LARGEST_LIFT * radius_m:
            return 1
    return 0


@inner
def _swinging(base: int, mirrored: bool, root: FloatArray, rate: FloatArray) -> float:
    """|rate|² without the mean of the velocity, which all points share; never below its round-off."""
    whole, mass = dot(rate, rate), dot(root, root)
    total = whole
    for k in range(1 if mirrored else 0, 3 if base > 0 else 0):
        mean = dot(root, rate[k])
        total -= mean * mean / mass
    return max(total, 1e-10 * whole)


@inner
def _error(
    h: float, mass_kg: float, radius_m: float, rows: FloatArray, vector: FloatArray, gain: FloatArray,
    scratch: FloatArray, product: FloatArray,
) -> float:  # fmt: skip
    """Estimate of the step's error over the radius: h³ü/12 as a root mean square of the tube's points."""
    for d in range(vector.shape[0]):
        scratch[d] = vector[d] / h - gain[d]
    combine_rows(rows, vector.shape[0], scratch, product)
    return h * h / 12.0 * np.sqrt(dot(product, product) / mass_kg) / radius_m


@inner
def _step(h: float, state: State, physics: Physics, rule: Rule, contacts: Contacts, work: Work, layout: Layout) -> int:
    """One step of h, or none: 0: done; 1: too coarse, nothing changed; 2: not finite, nothing changed."""
    size, base, modes = layout.columns, layout.base, layout.modes
    strain, velocity, position, flag = state.strain, state.velocity, state.position_m, state.flag
    matrix, vector, mean, theta, column = work.matrix, work.vector, work.mean, work.theta, work.column
    rows, rate, ahead, change, bias = work.rows, work.rate, work.ahead, work.change, work.bias
    arm, less, bend = work.arm_m, rule.inverse_root, 0.5 * physics.radius_m
    gx, gy, gz = physics.gravity_x_m_s2, physics.gravity_y_m_s2, physics.gravity_z_m_s2
    stretch = strain[3 * modes] if physics.stretches else 1.0
    stretching = velocity[6 + 3 * modes] if physics.stretches else 0.0
    set_theta(h, physics.damping_time_s, state.modal_rate_1_s2, theta)
    place_rod(state, physics, rule, work, layout, 0.5 * h)
    copy_into(velocity, work.before)
    rolling = roll_rate(state.rotation, velocity)
    carry_spin(state.rotation, work.rotation, velocity)
    carry_bends(0.5 * h * rolling, rolling, modes, strain, work.strain, velocity)
    strain_forces(
        h, physics.damping_time_s, rolling, modes, theta, strain, work.strain, state.rest_strain, velocity, work.off
    )  # fmt: skip
    gather(velocity, column, vector)
    combine_rows(rows, size, vector, rate)
    turn_gain(h * rolling, base, modes, column, state.gain)
    for d in range(size):
        f = int(column[d])
        mean[f] = velocity[f] + 0.5 * h * state.gain[d]
        vector[d] = mean[f]
    combine_rows(rows, size, vector, work.foretold)
    twisting = accelerations(
        h, work.rotation, mean, work.foretold, stretch, stretching, bend, rule, work.strain, work.section,
        work.triple, bias,
    )  # fmt: skip
    swinging = _swinging(base, physics.mirrored, rule.root_mass, work.foretold)
    if twisting > _LARGEST_SWING**2 * (swinging + physics.mass_kg * physics.sleep_speed_m_s**2):
        copy_into(work.before, velocity)
        return 1
    # the velocities that strains carry stand for the time (1 − θ)h after the middle of the step (u̇ = −Gᵀb, steadily)
    add_scaled(rate, theta[6] - 1.0, bias, ahead)
    push(h, bend, gx, gy, gz, rule, state.push_N, state.push_N_m, bias)
    touching = False
    if physics.ground > 0:
        touching = find_contacts(
            h, theta[0], position, velocity, physics, contacts, work.place_m, less, rate, work.foretold, ahead, bias
        )  # fmt: skip
    gram(flat_rows(rows), size, work.inertia, False)
    kept = base > 0 and not touching
    if kept and flag[ALOFT] == 0.0:  # the momentum that it takes off with
        copy_into(work.before, velocity)
        place_rod(state, physics, rule, work, layout, 0.0)
        gather(velocity, column, vector)
        combine_rows(rows, size, vector, rate)
        take_momentum(base, rows, rate, column, arm, state.momentum)
        place_rod(state, physics, rule, work, layout, 0.5 * h)
        carry_spin(state.rotation, work.rotation, velocity)
        carry_bends(0.5 * h * rolling, rolling, modes, strain, work.strain, velocity)
        gather(velocity, column, vector)
        combine_rows(rows, size, vector, rate)
    moving = dot(rate, rate)
    again = True
    for sweep in range(_PASSES):
        flag[SOLVES] += 1.0
        if touching:
            contact_rows(h, theta[0], physics, contacts, rule.root_mass, less, rows, ahead, work.triple[0])
        for a in range(size):
            vector[a] = dot(rows[a], bias)
            if touching:
                vector[a] += dot(contacts.rows[a], contacts.drive)
            for b in range(a + 1):
                matrix[a, b] = work.inertia[a, b]
        if touching:
            gram(flat_rows(contacts.rows), size, matrix, True)
        elastic_forces(
            h, physics.damping_time_s, base, column, theta, state.stiffness, work.off, matrix, vector
        )  # fmt: skip
        if physics.softening_m2 > 0.0:
            softening(
                h, physics.softening_m2, physics.tightest_1_m,
                physics.bending_N_m2 * physics.length_m / physics.mass_kg, base, column, work.strain, rule,
                work.triple[0], vector,
            )  # fmt: skip
        if not factorise(matrix, size):
            copy_into(work.before, velocity)
            return 2
        solve_forward(matrix, size, vector)
        solve_backward(matrix, size, vector)
        for d in range(size):
            f = int(column[d])
            mean[f] = velocity[f] + theta[f] * vector[d]
        combine_rows(rows, size, vector, change)
        if sweep == _PASSES - 1:
            break
        repeat = False
        if physics.ground > 0:
            repeat = contradicted(h, theta[0], physics, contacts, less, change)
            touching = touching or repeat
            kept = base > 0 and not touching
        if again:
            missed = _missed(rate, change, work.foretold)
            # b goes with the square of the velocity: its change is 2 |b| |what u was missed by| / |u|
            pull = physics.mass_kg * (h * (abs(gx) + abs(gy) + abs(gz))) ** 2
            if 4.0 * twisting * missed > _AGAIN * _AGAIN * moving * (moving + pull):
                repeat = True
                again = False
                stretching = mean[6 + 3 * modes] if physics.stretches else 0.0
                add_scaled(rate, 0.5, change, work.foretold)
                accelerations(
                    h, work.rotation, mean, work.foretold, stretch, stretching, bend, rule, work.strain, work.section,
                    work.triple, bias,
                )  # fmt: skip
                push(h, bend, gx, gy, gz, rule, state.push_N, state.push_N_m, bias)
        if not repeat:
            break
    after = flat(bias)  # free from here on
    if kept:
        now, scratch = after[:6], flat(change)
        outside_impulse(
            0.5 * h, physics.mass_kg, gx, gy, gz, state.push_N, state.push_N_m, work.place_m, arm, state.momentum, now
        )  # fmt: skip
        base_that_keeps_momentum(base, now, column, arm, theta, velocity, matrix, mean, vector, scratch)
    verdict = _trusted(
        h, physics.length_m, physics.radius_m, modes, stretch, touching, roll_rate(work.rotation, mean), vector, mean,
        column, theta, work.strain,
    )  # fmt: skip
    if verdict > 0:
        copy_into(work.before, velocity)
        return verdict
    flag[ADVICE] = 2.0 * h
    if physics.tolerance > 0.0 and flag[STEPS] > 0.0:
        error = _error(
            h, physics.mass_kg, physics.radius_m, rows, vector, state.gain, flat(work.triple), work.foretold
        )  # fmt: skip
        flag[ADVICE] = h * min(2.0, max(0.25, 0.9 * (physics.tolerance / max(error, 1e-30)) ** (1.0 / 3.0)))
        if error > 2.0 * physics.tolerance and h > 2.0**-_HALVINGS * physics.step_s:
            copy_into(work.before, velocity)
            return 1
    if touching:
        keep_contacts(h, theta[0], physics, contacts, less, change, ahead)
        flag[ALOFT] = 0.0
    else:
        if flag[ALOFT] == 0.0:
            drop_contacts(contacts.load_m_s2, contacts.bristle_m, contacts.roll_bristle)
        flag[ALOFT] = 1.0
        if kept:
            now = after[:6]
            outside_impulse(
                h, physics.mass_kg, gx, gy, gz, state.push_N, state.push_N_m, work.place_m, arm, state.momentum, now
            )  # fmt: skip
            for k in range(6):
                state.momentum[k] = now[k]
    for d in range(size):
        velocity[int(column[d])] += vector[d]
        state.gain[d] = vector[d] / h
    rolled = h * roll_rate(work.rotation, mean)
    bend_on(h, rolled / h, modes, strain, mean, work.strain, strain)
    if physics.stretches:
        strain[3 * modes] += h * mean[6 + 3 * modes]
    carry_bends(rolled - 0.5 * h * rolling, roll_rate(work.rotation, velocity), modes, work.strain, strain, velocity)
    if physics.stretches and strain[3 * modes] < _LEAST_STRETCH:  # squeezed flat: no law of the wall goes further
        strain[3 * modes] = _LEAST_STRETCH
        velocity[6 + 3 * modes] = max(velocity[6 + 3 * modes], 0.0)
    for k in range(3):
        position[k] += h * mean[k]
    advance_rotation(h, work.rotation[:, 2], mean[3], mean[4], mean[5], state.rotation)
    carry_spin(work.rotation, state.rotation, velocity)
    still = moving < physics.mass_kg * physics.sleep_speed_m_s**2
    if still and (touching or (gx == 0.0 and gy == 0.0 and gz == 0.0)):
        flag[RESTED] += h
    else:
        flag[RESTED] = 0.0
    flag[STEPS] += 1.0
    return 0


@inner
def _follow_drive(drive: FloatArray, t_s: float, h: float, state: State, physics: Physics, theta: FloatArray) -> bool:
    """Rest curvature for the step of h from t_s; the actuators' work goes into the ledger. False when it is the old."""
    strain, rest, velocity, flag = state.strain, state.rest_strain, state.velocity, state.flag
    set_theta(h, physics.damping_time_s, state.modal_rate_1_s2, theta)
    # the bend as it will lie at the middle of the step, for the second order
    bend_1, bend_2 = strain[1] + 0.5 * h * velocity[7], -strain[0] - 0.5 * h * velocity[6]
    k1, k2 = rest_curvature(drive, t_s, h, theta[6], bend_1, bend_2, state.lagged_1_m)
    if rest[0] == -k2 and rest[1] == k1:
        return False
    before = elastic_energy_J(strain, rest, state.stiffness)
    rest[0], rest[1] = -k2, k1
    flag[WORK] += elastic_energy_J(strain, rest, state.stiffness) - before
    flag[RESTED] = flag[ASLEEP] = 0.0
    return True


@kernel(_nrt=False, nogil=True, fastmath=FAST_MATH)
def play(
    memory: FloatArray,
    places: IntArray,
    physics: Physics,
    drive: FloatArray,
    samples: int,
    steps: int,
    out: FloatArray,
    seen: FloatArray,
) -> int:
    """Advance a rod by samples × steps steps; a row of `out` after each sample. Returns the samples done.

    memory, places: as `rod_memory.carve` takes them. drive: as `rod_drive` has it. out: (samples, ROW_SIZE), or
    (0, ROW_SIZE) for none. seen: the beginning of the memory after each sample (`rod_memory.Instants`), or none of
    it, (0, …). steps = 0 only looks at the rod as it is, or at the instants of `seen` one after another.
    """
    layout, state, rule, contacts, work = carve(memory, places)
    going = True
    macro = physics.step_s
    flag = state.flag
    pushed = dot(state.push_N, state.push_N) + dot(state.push_N_m, state.push_N_m) > 0.0
    if pushed:  # the work of these is in no ledger
        flag[AUDITED] = 0.0
    if steps > 0 and not pushed and flag[AUDITED] == 0.0:  # what the first step may not exceed
        audit_energy(state, physics, rule, contacts, work, layout)
    quiet_s = quiet_until_s(drive) - 2.0 * macro  # a straight tube that sleeps has nothing to look at until then
    if drive[0] > 0.0 and (state.rest_strain[0] != 0.0 or state.rest_strain[1] != 0.0):
        quiet_s = -1.0
    if physics.stretches and not state.rest_strain[3 * layout.modes] > 0.0:
        return 0
    for sample in range(samples):
        for _ in range(steps):
            if flag[ASLEEP] > 0.0 and flag[TIME] < quiet_s:
                flag[TIME] += macro
                continue
            if flag[ASLEEP] > 0.0:
                lagged_1, lagged_2 = state.lagged_1_m[0], state.lagged_1_m[1]
                if drive[0] == 0.0 or not _follow_drive(drive, flag[TIME], macro, state, physics, work.theta):
                    flag[TIME] += macro
                    continue
                # nothing is known yet of what it wakes to
                state.lagged_1_m[0], state.lagged_1_m[1] = lagged_1, lagged_2
                flag[ADVICE], flag[AUDITED] = _WAKING * macro, 1.0 / _WAKING
            done = 0.0
            while done < macro:
                h = macro - done
                if flag[AUDITED] > 1.0:  # this step makes energy
                    h = min(h, 0.5 * macro)
                longest = min(flag[ADVICE], growing_step_s(drive, flag[TIME] + done))
                if longest < h:
                    h /= np.ceil(h / longest - 1e-9)
                solves = flag[SOLVES]
                lagged_1, lagged_2 = state.lagged_1_m[0], state.lagged_1_m[1]
                if drive[0] > 0.0:
                    _follow_drive(drive, flag[TIME] + done, h, state, physics, work.theta)
                verdict = _step(h, state, physics, rule, contacts, work, layout)
                if verdict == 0:
                    troubled = h < macro or flag[SOLVES] > solves + _EASY_SOLVES or flag[AUDITED] > 1.0
                    if not pushed and (troubled or flag[STEPS] % _AUDIT_STEPS == 1.0):
                        audit_energy(state, physics, rule, contacts, work, layout)
                    done = macro if h >= (macro - done) * (1.0 - 1e-12) else done + h
                else:
                    state.lagged_1_m[0], state.lagged_1_m[1] = lagged_1, lagged_2
                    flag[ADVICE] = 0.5 * h
                    if flag[ADVICE] < 2.0**-_HALVINGS * macro:
                        going = False
                        break
            if not going:
                break
            flag[TIME] += macro
            if physics.softening_m2 > 0.0:
                note_kink(state.strain, rule.mode, physics.softening_m2, flag)
            if flag[RESTED] > _REST_TIME_S:
                flag[ASLEEP] = 1.0
                for f in range(state.velocity.shape[0]):
                    state.velocity[f] = 0.0
        if not going:
            return sample
        if seen.shape[0] > 0:
            if steps > 0:
                copy_into(memory[: seen.shape[1]], seen[sample])
            else:
                copy_into(seen[sample], memory)
        if out.shape[0] > 0:
            if flag[ASLEEP] > 0.0 and sample > 0 and out[sample - 1, 35] > 0.0:
                for k in range(ROW_SIZE):
                    out[sample, k] = out[sample - 1, k]
                out[sample, 0] = flag[TIME]
            else:
                place_rod(state, physics, rule, work, layout, 0.0)
                gather(state.velocity, work.column, work.vector)
                combine_rows(work.rows, layout.columns, work.vector, work.rate)
                write_row(state, physics, rule, work, layout, out[sample])
    return samples
