"""Which discrete choices a step makes: two states that choose differently lie on two sides of a kink."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.native_step.stepper import Stepper
from cmbrl.scene.layout import ACTUATOR_FIELDS, CONTACT_FIELDS

Array = NDArray[np.float64]


def choices(model: ComplementarityModel, q: Array, v: Array, u: Array, theta: Array) -> NDArray[np.bool_]:
    """The choices (B, n) of a step from q (B, nq), v (B, nv) under u (B, nu) with parameters theta (np,).

    They are the signs of gaps and limit margins, the nearer limit, clamped controls, forces and time constants, rows
    left out of the solve, and whether restitution acts.
    """
    scene, core, h = model.scene, model.scene.core, model.time_step
    if model.integrator in ("leapfrog", "midpoint"):
        q = scene.integrate(q, 0.5 * h * v)
    smooth = model.smooth_dynamics(q, v, theta)
    gap, normal = smooth["gap"], smooth["J"][:, :, 0]
    speed = np.einsum("bcv,bv->bc", normal, v)
    lengths = smooth["length"]
    rates = _rates(model, q, v)
    x = lengths[:, core.lim_line]
    P = scene.physical_vector(theta)
    wider = P[[scene.layout.dof(line, "wider") for line in core.lim_line.tolist()]]
    below, above = x - core.lim_lo + wider, core.lim_hi - x + wider
    springs = P[[scene.layout.dof(scene.nv + k, "springref") for k in range(core.ntendon)]]
    near, side = np.minimum(below, above), np.where(below < above, 1.0, -1.0)
    parts = [
        gap > 0,
        gap > core.con_margin,
        gap > core.con_reach,
        gap / h + speed < model.stepper.options["prune"],
        below < above,
        near > core.lim_margin,
        lengths[:, scene.nv :] > springs,
        lengths[:, scene.nv :] > springs + core.line_slack[scene.nv :],
        near / h + side * rates[:, core.lim_line] < model.stepper.options["prune"],
        *_clamps(model, lengths, rates, u, P),
    ]
    if any(p.group == "restitution" for p in scene.parameters):
        one = model.with_settings(parameters=None, integrator="semi-implicit", substeps=1).stepper
        free = Stepper(scene, {**one.options, "prune": -np.inf}, one.threads)  # leaves all contacts out
        approach = -np.einsum("bcv,bv->bc", normal, free.forward(q, v, u, theta)["v_next"])
        parts += [approach > 3 * 9.81 * h, gap < approach * h]
    return np.concatenate(parts, axis=1)


def _rates(model: ComplementarityModel, q: Array, v: Array) -> Array:
    """Rates (B, nv + ntendon) of lines; those of tendons by differences of their lengths."""
    if not model.scene.core.ntendon:
        return v
    step, still = 1e-6, np.zeros_like(v)
    ahead, behind = (
        model.smooth_dynamics(model.scene.integrate(q, sign * step * v), still)["length"] for sign in (1, -1)
    )
    return np.asarray((ahead - behind) / (2 * step))


def _clamps(model: ComplementarityModel, lengths: Array, rates: Array, u: Array, P: Array) -> list[NDArray[np.bool_]]:
    scene, core, layout = model.scene, model.scene.core, model.scene.layout
    first = layout.contact(0, "solref0")
    time = P[first : first + core.ncontact * len(CONTACT_FIELDS) : len(CONTACT_FIELDS)]
    numbers = P[layout.actuator(0) : layout.fluid].reshape(-1, len(ACTUATOR_FIELDS)).T
    gear, gain, bias0, bias1, bias2, _, limit, slope, gap = numbers
    low, high = np.reshape(core.act_ctrl, (-1, 2)).T
    least, most = np.reshape(core.act_force, (-1, 2)).T
    length, rate = gear * lengths[:, core.act_line], gear * rates[:, core.act_line]
    u, activation = np.split(u, [scene.nu], axis=1)
    given, bounds = np.clip(u, low, high), []
    if model.activations is not None:
        after = model.activations.next(torch.from_numpy(np.concatenate([u, activation], axis=1))).numpy()
        given[:, core.state_act] = np.where(core.state_early, after, activation)
        bounds = [after == x for x in np.reshape(core.state_range, (-1, 2)).T]
    by_length, by_rate = np.reshape(core.act_gain, (-1, 2)).T
    bias1, bias2 = bias1 + by_length * given, bias2 + by_rate * given
    spring, slack = gain * given + bias0 + bias1 * length, np.abs(gear * bias1 * gap)
    feeds = np.repeat(np.arange(core.nact), np.diff(core.feed_ptr))
    np.add.at(spring.T, feeds, (gain * given)[:, core.feed_act].T)
    force = spring - np.clip(spring, -slack, slack) + bias2 * rate
    least = np.maximum(least, np.minimum(slope * np.maximum(-rate, 0.0) - limit, 0.0))
    most = np.minimum(most, np.maximum(limit - slope * np.maximum(rate, 0.0), 0.0))
    bounds += [spring < -slack, spring > slack, (slope > 0) & (rate > 0)]
    shortest = np.tile(time > 2 * model.time_step, (len(u), 1))  # MuJoCo's least time constant
    pulls = np.zeros((len(u), scene.nv + core.ntendon))
    single = core.act_line >= 0
    np.add.at(pulls.T, core.act_line[single], (gear * np.clip(force, least, most)).T[single])
    drive = pulls[:, : scene.nv].copy()  # without those of tendons through sites
    tendon = np.repeat(np.arange(core.ntendon), np.diff(core.tendon_ptr))
    np.add.at(drive.T, core.tendon_dof, (pulls[:, scene.nv + tendon] * core.tendon_coef).T)
    drive = drive[:, core.frc_dof]
    lowest, highest = np.reshape(core.frc_range, (-1, 2)).T
    return [u < low, u > high, force < least, force > most, drive < lowest, drive > highest, shortest, *bounds]
