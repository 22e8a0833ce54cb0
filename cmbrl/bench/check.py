"""How well a scene repeats MuJoCo on its own file, and how right and fast it is: what ``cmbrl check`` measures."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from cmbrl.bench.check_dynamics import dynamics
from cmbrl.bench.check_line import Line
from cmbrl.bench.check_reasons import option, reason
from cmbrl.bench.check_steps import States, controls, mujocos, places, step_errors, visit
from cmbrl.bench.states import with_activations
from cmbrl.bench.studies.derivatives.differences import measure as measure_derivatives
from cmbrl.bench.studies.robustness.cells import measure as measure_robustness
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.step_settings import RK4
from cmbrl.scene import Scene
from cmbrl.scene.records import Array
from cmbrl.scene.source.mjcf import act_addresses

STEP = 0.05  # the largest error of a step
MANY = 20  # states with contact at least, to be judged by themselves
THROWN = 1.0  # m/s, rad/s: of all coordinates, so that what no actuator moves slides and hits something, too


def check(
    scene: Scene, theirs: mujoco.MjModel, states: int, wild: int, seed: int = 0, only: str | None = None
) -> list[Line]:
    """Measurements of ``scene`` and of MuJoCo's model of it, on as many states from the home pose on, and wild ones.

    ``only`` one part: dynamics, steps, derivatives, wild or times. Raises UserError where the solver refuses the
    parameters of the scene.
    """
    model = ComplementarityModel(scene)
    measure: dict[str, Callable[[np.random.Generator], list[Line]]] = {
        "dynamics": lambda rng: dynamics(scene, model, theirs, rng),
        "steps": lambda rng: _all_steps(scene, model, theirs, states, rng),
        "derivatives": lambda rng: _derivatives(scene, seed),
        "wild": lambda rng: _wild(model, wild, seed),
        "times": lambda rng: _speed(scene, model, theirs, rng),
    }
    parts = measure if only is None else [only]
    return [line for part in parts for line in measure[part](np.random.default_rng(seed))]


def _all_steps(
    scene: Scene, model: ComplementarityModel, theirs: mujoco.MjModel, count: int, rng: np.random.Generator
) -> list[Line]:
    settings = mujocos(scene)
    models = [model, *([model.with_settings(**settings)] if settings else [])]
    homes = places(scene, theirs)
    seen = {where: visit(scene, theirs, home, count, rng) for where, home in homes.items()}
    unseen: list[Line] = []
    if settings:  # other laws bounce in another way
        where, home = list(homes.items())[-1]
        try:
            seen[f"thrown {where}"] = visit(scene, theirs, home, count, rng, THROWN)
        except UserError:  # but not at rest: dampers may bear no such speeds
            meaning = f"MuJoCo itself diverges from velocities of {THROWN:g} m/s and rad/s"
            unseen = [Line("states thrown", 0.0, None, meaning)]
    judged = [line for where, states in seen.items() for line in _steps(scene, models, theirs, where, states)]
    return judged + unseen


def _derivatives(scene: Scene, seed: int) -> list[Line]:
    found = measure_derivatives(scene, "kappa 1e-4", 4, seed)
    return [
        Line("derivatives, median", found["median"], 1e-6, "relative error against finite differences"),
        Line("derivatives, worst", found["worst"], 1e-4, "the same, of the worst column"),
    ]


def _wild(model: ComplementarityModel, count: int, seed: int) -> list[Line]:
    row = measure_robustness(model, count, seed)
    flagged, silent = row["flagged"] / count, float(row["silent"] + row["nan"])
    return [
        Line("wild states flagged", flagged, 1e-4, f"share of {count} wild states whose solve fails and says so"),
        Line("wild states wrong", silent, 0.0, "states that are wrong and not flagged, or not finite"),
    ]


def _steps(
    scene: Scene, models: list[ComplementarityModel], theirs: mujoco.MjModel, where: str, states: States
) -> list[Line]:
    """One step of the file's length from ``states`` against mj_step, under the default's laws and under MuJoCo's.

    Under MuJoCo's laws the median is judged, and what nine of ten states with contact stay below. Where links touch in
    some of the states and not in others, another line is of those in which nothing touches. Where an error is above the
    limit, one more says without what it would not be; of the default, which option takes it away.
    """
    found, apart = step_errors(models, theirs, states)
    touching = ~apart if (~apart).sum() >= MANY else np.ones_like(apart)
    meaning = f"one step against mj_step from {len(apart)} states, root mean square of the change of velocity; median"
    if states.share < 1:
        meaning += f"; controls within {states.share:.0%} of their ranges, since MuJoCo diverges under stronger ones"
    if states.speed:
        meaning += f"; episodes begin with random velocities of {states.speed:g} m/s and rad/s"
    default, nearest, both = found[0], found[-1], len(models) > 1
    lines = [Line(f"step {where}", float(np.median(default)), None if both else STEP, meaning)]
    if both:
        rk4 = ", RK4" if scene.integrator == RK4 else ""
        meaning = f"the same under MuJoCo's laws: convex sliding, rows that do not look ahead{rk4}; above, the default"
        lines.append(Line(f"step {where}, convex", float(np.median(nearest)), STEP, meaning))
        of = "states" if touching.all() else f"of the {touching.sum()} states in which something touches"
        meaning = f"the same, what nine of ten {of} stay below; the other tenth may be worse"
        rare = float(np.quantile(nearest[touching], 0.9))
        lines.append(Line(f"step {where}, convex, 9 of 10", rare, STEP, meaning))
    if both and lines[0].value > STEP and (why := option(models[0], theirs, states, lines[0].value)):
        meaning = "the default, with this option of a model (or fit): it makes most of the difference"
        lines.insert(1, Line(f"step {where}, {why[0]}", why[1], None, meaning))
    if not all(line.holds for line in lines) and (why := _reason(scene, models[-1], theirs, states, nearest, touching)):
        meaning = "the same, with this part of the file changed for both, or this option: it makes the difference"
        lines.append(Line(f"step {where}, {why[0]}", why[1], None, meaning))
    if apart.any() and not apart.all():
        meaning = f"the same, of the {apart.sum()} states in which nothing touches in MuJoCo"
        lines.append(Line(f"step {where}, apart", float(np.median(nearest[apart])), STEP, meaning))
    return lines


def _reason(
    scene: Scene,
    model: ComplementarityModel,
    theirs: mujoco.MjModel,
    states: States,
    errors: Array,
    touching: NDArray[np.bool_],
) -> tuple[str, float] | None:
    """Without what the median error is within the limit; if it is anyway, that of the worst fifth of ``touching``."""
    if np.median(errors) <= STEP:
        worst = touching & (errors >= np.quantile(errors[touching], 0.8))
        states, errors = states.chosen(worst), errors[worst]
    return reason(scene, model.sliding, theirs, states, float(np.median(errors)), STEP)


def _speed(scene: Scene, model: ComplementarityModel, theirs: mujoco.MjModel, rng: np.random.Generator) -> list[Line]:
    """Time of a step and of a step with its vector-Jacobian product, in times of mj_step; one thread, 64 states."""
    place = list(places(scene, theirs).values())[-1]
    noise = 0.02 * rng.normal(size=(64, scene.nv))
    q, v = scene.integrate(np.tile(place, (64, 1)), noise), 0.1 * rng.normal(size=(64, scene.nv))
    u = with_activations(scene, controls(theirs, 64, rng), rng)
    acts = act_addresses(theirs, scene.core.state_act)
    data, states = mujoco.MjData(theirs), iter(range(10**9))

    def their_step() -> None:
        for _ in range(64):
            k = next(states) % 64
            data.qpos[:], data.qvel[:], data.ctrl[:], data.act[acts] = q[k], v[k], *np.split(u[k], [scene.nu])
            mujoco.mj_step(theirs, data)

    def times(model: ComplementarityModel) -> tuple[float, float]:
        def product() -> None:
            out = model.stepper.forward(q, v, u, model.parameters, tape=True)
            model.stepper.backward(u, model.parameters, out["tape"], v, v)

        return _fastest(lambda: model.stepper.forward(q, v, u, model.parameters)) / mj, _fastest(product) / mj

    mj = _fastest(their_step)
    forward, product = times(model)
    lines = [
        Line("time of a step", forward, 1.0, "in times of mj_step on the same states, one thread, 64 states a call"),
        Line("time with gradient", product, 1.0, "the same, with its vector-Jacobian product"),
    ]
    if mujocos(scene).get("integrator", model.integrator) != model.integrator:
        forward, product = times(model.with_settings(integrator=RK4))
        lines += [
            Line("time of a step, rk4", forward, None, "the same with integrator='rk4': four contact solves a step"),
            Line("time with gradient, rk4", product, None, "the same, with its vector-Jacobian product"),
        ]
    return lines


def _fastest(work: Callable[[], Any], repeats: int = 7) -> float:
    best = np.inf
    for _ in range(repeats):
        begin = time.thread_time()
        work()
        best = min(best, time.thread_time() - begin)
    return best
