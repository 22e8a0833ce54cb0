"""What others make of a log of positions and commands: mujoco.sysid, and PACE's parameters fitted by CMA-ES.

Both simulate MuJoCo with the file from the start of the log under its commands, and fit positions up to --until. PACE
(Bjelonic et al., arXiv 2509.06342) fits armature, damping, friction loss and encoder bias of each joint, and one delay;
mujoco.sysid gets these, or all parameters that `cmbrl fit` moves and a compiled MuJoCo model has. The rest is judged.

    python scripts/position_rivals.py robot.xml log.npz --until 10.67 --out rivals.json

needs the extras `fit` and `bench`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from io import StringIO

import mujoco
import numpy as np
from mujoco import rollout

from cmbrl.bench.peers.mujoco_model import GROUPS, robot_model, with_parameters
from cmbrl.data.estimation import estimated
from cmbrl.data.position_log import PositionLog
from cmbrl.files import write_json
from cmbrl.models.between.observation import Observation
from cmbrl.scene import Scene
from cmbrl.scene.records import Parameter

PACE = ("armature", "damping", "frictionloss")
GENERATIONS, POPULATION = 300, 32


class Simulation:
    """MuJoCo from the start of the log; ``parameters`` are those of the scene in ``groups``, biases and a delay."""

    def __init__(self, scene: Scene, log: PositionLog, until: float, groups: tuple[str, ...]) -> None:
        self.data, self.base = estimated(log, scene), robot_model(scene.path)
        self.between = Observation.of(scene, self.data.dt)
        late = [p for p in self.between.parameters if p.group != "lag"]
        self.parameters: list[Parameter] = [p for p in scene.parameters if p.group in groups] + late
        self.after = log.time[1:] > until
        self.simulations = 0

    def errors(self, values: np.ndarray) -> np.ndarray:
        """Position errors (T, n) [rad] of parameter values (p,)."""
        told = dict(zip((p.name for p in self.parameters), values, strict=True))
        between = {p.name: told.pop(p.name) for p in self.between.parameters if p.name in told}
        data = self.between.states(self.data, self.between.vector(between))
        model = with_parameters(self.base, told)
        start = np.concatenate([[0.0], data.q[0], data.v[0]])[None]
        state, _ = rollout.rollout(model, [mujoco.MjData(model)], start, data.u[None])
        self.simulations += 1
        return state[0, :, 1 : 1 + model.nq] - data.q_next

    def judged(self, values: np.ndarray) -> dict[str, float]:
        """Mean absolute errors [rad] of what was fitted and of what follows."""
        size = np.abs(self.errors(values))
        return {"fitted": float(size[~self.after].mean()), "after": float(size[self.after].mean())}


def pace(simulation: Simulation, seed: int = 0) -> np.ndarray:
    """CMA-ES on the mean squared error, in shares of the bounds; logarithmic where they allow it."""
    from cmaes import CMA

    low, high = (np.array([getattr(p, side) for p in simulation.parameters]) for side in ("low", "high"))
    logs = np.array([p.transform == "log" for p in simulation.parameters])

    def values(share: np.ndarray) -> np.ndarray:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(logs, low * (high / low) ** share, low + share * (high - low))

    start = np.full(len(low), 0.5)
    start[[p.low == 0.0 for p in simulation.parameters]] = 0.1
    search = CMA(
        mean=start, sigma=0.15, bounds=np.array([[0.0, 1.0]] * len(low)), seed=seed, population_size=POPULATION
    )
    best, least = start, np.inf
    for _ in range(GENERATIONS):
        asked = [search.ask() for _ in range(POPULATION)]
        losses = [float((simulation.errors(values(x))[~simulation.after] ** 2).mean()) for x in asked]
        search.tell(list(zip(asked, losses, strict=True)))
        if min(losses) < least:
            best, least = asked[int(np.argmin(losses))], min(losses)
    return values(best)


def sysid(simulation: Simulation) -> np.ndarray:
    """mujoco.sysid's own optimiser, from the file's values, on the same errors."""
    from mujoco import sysid as toolbox

    parameters = toolbox.ParameterDict()
    for p in simulation.parameters:
        parameters.add(toolbox.Parameter(p.name, p.nominal, p.low, p.high))

    def residual(columns: np.ndarray, _: object) -> tuple[list[np.ndarray], None, None]:
        found = [simulation.errors(x)[~simulation.after].ravel() for x in columns.reshape(len(columns), -1).T]
        stacked = np.stack(found, axis=1) / np.sqrt(len(found[0]))
        return [stacked if columns.ndim > 1 else stacked[:, 0]], None, None

    with redirect_stdout(StringIO()):
        fitted, _ = toolbox.optimize(parameters, residual, "mujoco", verbose=False, max_iters=40, eps=1e-5)
    return np.asarray(fitted.as_vector())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("log")
    parser.add_argument("--until", type=float, required=True, help="last second that is fitted")
    parser.add_argument("--out", required=True)
    arguments = parser.parse_args()
    scene, log = Scene.from_mjcf(arguments.scene), PositionLog.load(arguments.log)
    every = tuple(g for g in GROUPS if g not in ("gravity", "kp", "kd"))
    methods: dict[str, tuple[Callable[[Simulation], np.ndarray], tuple[str, ...]]] = {
        "nominal": (lambda s: np.array([p.nominal for p in s.parameters]), PACE),
        "mujoco.sysid, PACE's parameters": (sysid, PACE),
        "mujoco.sysid, all parameters": (sysid, every),
        "PACE's parameters by CMA-ES": (pace, PACE),
    }
    found = {}
    for name, (method, groups) in methods.items():
        simulation, began = Simulation(scene, log, arguments.until, groups), time.process_time()
        values = method(simulation)
        seconds, simulations = time.process_time() - began, simulation.simulations
        bounds = sum(bool(np.isclose(x, p.low) or np.isclose(x, p.high)) and x != p.nominal
                     for x, p in zip(values, simulation.parameters, strict=True))  # fmt: skip
        found[name] = {"parameters": len(values), "on_a_bound": int(bounds), "simulations": simulations,
                       "processor_seconds": round(seconds, 1), **simulation.judged(values)}  # fmt: skip
        print(name, found[name], flush=True)
        write_json(arguments.out, found)


if __name__ == "__main__":
    main()
