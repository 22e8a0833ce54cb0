"""What a step is made of, against MuJoCo's: mass matrix, forces and contact rows, for ``cmbrl check``."""

from __future__ import annotations

import copy
from collections.abc import Iterator

import mujoco
import numpy as np

from cmbrl.bench.check_line import Line
from cmbrl.bench.check_steps import controls, mujocos, places, visit
from cmbrl.bench.states import with_activations
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.records import Array
from cmbrl.scene.source.mjcf import act_addresses

POSES = 50  # random ones of mass matrix and forces; visited ones, where rows are compared
EXACT = 1e-9  # of mass matrix and forces
_OFF = mujoco.mjtDisableBit
_CONSTRAINTS = _OFF.mjDSBL_CONTACT | _OFF.mjDSBL_LIMIT | _OFF.mjDSBL_EQUALITY | _OFF.mjDSBL_FRICTIONLOSS


def dynamics(scene: Scene, model: ComplementarityModel, theirs: mujoco.MjModel, rng: np.random.Generator) -> list[Line]:
    """Mass matrix and forces at random poses; contact rows at poses that MuJoCo visits from the home pose."""
    return [*_inertia(scene, model, theirs, rng), _forces(scene, theirs, rng), *_rows(scene, theirs, rng)]


def _random_poses(scene: Scene, rng: np.random.Generator) -> tuple[Array, Array]:
    q = scene.integrate(np.tile(scene.q0, (POSES, 1)), 0.5 * rng.normal(size=(POSES, scene.nv)))
    return q, rng.normal(size=(POSES, scene.nv))


def _inertia(
    scene: Scene, model: ComplementarityModel, theirs: mujoco.MjModel, rng: np.random.Generator
) -> Iterator[Line]:
    data, worst = mujoco.MjData(theirs), np.zeros(2)
    q, v = _random_poses(scene, rng)
    ours = model.smooth_dynamics(q, v, contacts=False)
    for k in range(POSES):
        data.qpos[:], data.qvel[:] = q[k], v[k]
        mujoco.mj_forward(theirs, data)
        M = np.zeros((scene.nv, scene.nv))
        for row, unit in zip(M, np.eye(scene.nv), strict=True):
            mujoco.mj_mulM(theirs, data, row, unit)
        size = float(np.abs(M).max())  # also the force that makes 1 m/s^2 or 1 rad/s^2: gravity may do nothing
        of_bias = max(float(np.abs(data.qfrc_bias).max()), size)
        errors = [np.abs(ours["M"][k] - M).max() / size, np.abs(ours["bias"][k] - data.qfrc_bias).max() / of_bias]
        worst = np.maximum(worst, errors)
    yield Line("mass matrix", float(worst[0]), EXACT, "largest difference from MuJoCo's, relative to its largest entry")
    yield Line("bias force", float(worst[1]), EXACT, "the same, of Coriolis, centrifugal and gravity forces")


def _forces(scene: Scene, theirs: mujoco.MjModel, rng: np.random.Generator) -> Line:
    """With actuators, springs, dampers and fluids: what accelerates the robot without constraints."""
    free = copy.deepcopy(theirs)
    free.opt.disableflags |= int(_CONSTRAINTS)
    ours = Scene.from_mjcf(free, scene.ignore, reduce=scene.reduce, self_contact="none", drives=scene.drives)
    model = ComplementarityModel(ours, **mujocos(ours), damping="split")
    acts, data, worst = act_addresses(free, ours.core.state_act), mujoco.MjData(free), 0.0
    q, v = _random_poses(ours, rng)
    u = with_activations(ours, controls(free, POSES, rng), rng)
    for k, problem in enumerate(model.contact_problems(q, v, u)):
        data.qpos[:], data.qvel[:], data.ctrl[:], data.act[acts] = q[k], v[k], *np.split(u[k], [ours.nu])
        mujoco.mj_forward(free, data)
        force = problem.M @ (problem.v_free - v[k]) / model.time_step
        size = max(np.abs(data.qfrc_smooth).max(), np.abs(problem.M).max())
        worst = max(worst, float(np.abs(force - data.qfrc_smooth).max() / size))
    meaning = "the same, with actuators, springs, dampers and fluids: all that acts without constraints"
    return Line("smooth force", worst, EXACT, meaning)


def _rows(scene: Scene, theirs: mujoco.MjModel, rng: np.random.Generator) -> Iterator[Line]:
    """Of MuJoCo's contacts, the row along the normal or the edges of the pyramid; nothing where none touches.

    MuJoCo's search for points of convex shapes runs to its end here.
    """
    if scene.contact_law != "mujoco":
        return
    model, sharp = ComplementarityModel(scene, **mujocos(scene)), copy.deepcopy(theirs)
    sharp.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    sharp.opt.ccd_tolerance, sharp.opt.ccd_iterations = 1e-12, 1000
    data, found = mujoco.MjData(sharp), []
    for home in places(scene, theirs).values():
        states = visit(scene, theirs, home, POSES, rng)
        for q, problem in zip(states.q, model.contact_problems(states.q, states.v, states.u), strict=True):
            data.qpos[:] = q
            mujoco.mj_forward(sharp, data)
            ours = problem.J.reshape(-1, scene.nv)
            found += [max(_distance(row, ours) for row in rows) for rows in _contact_rows(sharp, data)]
    if found:
        near = [100 * np.mean(np.array(found) <= limit) for limit in (1e-6, 1e-3)]
        meaning = (
            f"difference of a contact's row, relative to its largest entry; median of {len(found)}, of which "
            f"{near[0]:.0f} % are within 1e-6, {near[1]:.0f} % within 1e-3"
        )
        yield Line("contact rows", float(np.median(found)), None, meaning)


def _distance(row: Array, rows: Array) -> float:
    return float(np.abs(rows - row).max(axis=1).min(initial=np.abs(row).max()) / np.abs(row).max())


def _contact_rows(model: mujoco.MjModel, data: mujoco.MjData) -> Iterator[Array]:
    """Of each contact that acts, the rows (n, nv) with a normal part: one of a cone, all of a pyramid."""
    rows, cone = data.efc_J.reshape(-1, model.nv), model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    for contact in data.contact:
        start, count = contact.efc_address, 1 if cone or contact.dim == 1 else 2 * (contact.dim - 1)
        if start >= 0:
            yield rows[start : start + count]
