"""Random files against MuJoCo: what loads steps as ``mj_step`` does, with exact derivatives; the rest is refused.

Without constraints a step is MuJoCo's to round-off. Limits and equality constraints are exact too; dry friction is a
little rounded off; where shapes touch, a few pairs of shapes touch in another point than in MuJoCo.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable

import mujoco
import numpy as np
import pytest

from cmbrl.bench.check_steps import mujocos
from cmbrl.bench.states import Ranges, random_states
from cmbrl.bench.studies.derivatives.differences import measure
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene
from cmbrl.scene.source.mjcf import act_addresses
from cmbrl.scene.source.robot_source import quiet

from .robots import Robots

FEW, MANY = range(24), range(24, 500)
STATES = 8
DEEPEST, FASTEST = 0.005, 100.0  # m, and rad/s or m/s that a step may add: beyond, links are jammed in each other
STRONGEST = 1e12  # [N] of a row
OFF = mujoco.mjtDisableBit
ROWS = {
    "limits": OFF.mjDSBL_LIMIT,
    "dry friction": OFF.mjDSBL_FRICTIONLOSS,
    "equality constraints": OFF.mjDSBL_EQUALITY,
    "contacts": OFF.mjDSBL_CONTACT,
}
ACCURATE = {"nothing": 1e-9, "limits": 1e-5, "equality constraints": 1e-5, "dry friction": 0.02}


def compiled(seed: int) -> mujoco.MjModel | None:
    """MuJoCo's model of a random file, solved to round-off; None if it is not valid."""
    try:
        model = mujoco.MjModel.from_xml_string(Robots(seed).text())
    except ValueError:
        return None
    model.opt.tolerance, model.opt.iterations, model.opt.ls_iterations = 0, 200, 100
    return model if model.nv else None


def only(model: mujoco.MjModel, rows: str) -> mujoco.MjModel:
    """The same with constraints of one kind alone, or with "nothing", or "all"."""
    changed = copy.deepcopy(model)
    for kind, bit in ROWS.items():
        if rows not in (kind, "all"):
            changed.opt.disableflags |= int(bit)
    return changed


def errors(model: mujoco.MjModel, seed: int) -> np.ndarray:
    """Largest error of the next velocity, relative to the largest change, in states where MuJoCo's step is sound."""
    scene = Scene.from_mjcf(model, self_contact="all")
    q, v, u = random_states(scene, STATES, np.random.default_rng(seed), Ranges(gap=(-0.004, 0.003), speed=1.5))
    step = ComplementarityModel(scene, **mujocos(scene)).predict(q, v, u)
    assert np.isfinite(step.v_next).all(), seed
    assert (step.status != SolverStatus.FAILED).all(), seed
    data, found = mujoco.MjData(model), []
    for k in range(STATES):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = q[k], v[k], u[k, : model.nu]
        data.act[act_addresses(model, scene.core.state_act)] = u[k, model.nu :]
        mujoco.mj_step(model, data)
        change = np.abs(data.qvel - v[k]).max()
        jammed = change > FASTEST or (data.ncon and data.contact.dist.min() < -DEEPEST)
        jammed |= np.abs(data.efc_force).max(initial=0.0) > STRONGEST  # on a row without a lever, but for round-off
        if not (jammed or any(warning.number for warning in data.warning)):
            found.append(np.abs(step.v_next[k] - data.qvel).max() / (change + 1e-3))
    return np.array(found)


def refusal(model: mujoco.MjModel) -> str:
    """Why a file is refused; empty if it loads."""
    try:
        Scene.from_mjcf(model)
    except UserError as error:
        return str(error)
    return ""


def loaded(seeds: Iterable[int]) -> list[tuple[int, mujoco.MjModel]]:
    """Those that load; refusals must be one line with a remedy, and few."""
    models = [(seed, model) for seed in seeds if (model := compiled(seed))]
    told = {seed: why for seed, model in models if (why := refusal(model))}
    assert len(told) <= 0.1 * len(models), told
    for seed, why in told.items():
        assert "\n" not in why, seed
        assert "--ignore" in why or "give" in why, (seed, why)
    return [(seed, model) for seed, model in models if seed not in told]


def check_steps(seeds: Iterable[int]) -> None:
    touching: list[np.ndarray] = []
    with quiet():
        for seed, model in loaded(seeds):
            for rows, most in ACCURATE.items():
                worst = errors(only(model, rows), seed).max(initial=0.0)
                assert worst < most, f"seed {seed} with {rows} alone: {worst:.2g}"
            touching.append(errors(only(model, "all"), seed))
    of_all = np.concatenate(touching)
    assert np.median(of_all) < 1e-6
    assert np.mean(of_all < 0.02) > 0.8, np.sort(of_all)[-20:]


def check_derivatives(seeds: Iterable[int]) -> None:
    with quiet():
        worst = {
            seed: measure(Scene.from_mjcf(model), "kappa 1e-4", 2, seed, parameters=30)["worst"]
            for seed, model in loaded(seeds)
        }
    assert np.median(list(worst.values())) < 1e-7, worst
    off = {seed: value for seed, value in worst.items() if not value < 1e-4}
    assert len(off) <= 0.03 * len(worst), off  # differences across a kink that is not known to be one


def test_steps() -> None:
    check_steps(FEW)


def test_derivatives() -> None:
    check_derivatives(FEW[:10])


@pytest.mark.slow
def test_steps_of_many() -> None:
    check_steps(MANY)


@pytest.mark.slow
def test_derivatives_of_many() -> None:
    check_derivatives(MANY[:120])
