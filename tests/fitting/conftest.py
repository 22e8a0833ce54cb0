"""A model small enough to know by heart: carts on rails, so that the fit can be tested without the contact core.

    m dv/dt = gear u - damping v - frictionloss tanh(v / 0.05) - gravity_x m     semi-implicit Euler, one degree of
    freedom a cart

``bumper`` acts on nothing: the data cannot tell it.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import cmbrl
from cmbrl.data.transitions import Transitions
from cmbrl.fitting import Budget
from cmbrl.models.between.observation import Observation
from cmbrl.models.log_windows import Predicted
from cmbrl.models.windows import Windows
from cmbrl.models.windows import huber as huber_loss
from cmbrl.scene.layout import Layout
from cmbrl.scene.records import Parameter

from ..models.windows_by_steps import along_by_steps

H = 0.02
FIELDS = ("mass", "damping", "frictionloss", "gear")
NOMINAL = {"mass": 2.0, "damping": 0.5, "frictionloss": 0.8, "gear": 3.0}
WIDTH = 0.05


class CartScene:
    """``n`` independent carts; parameters are scales of NOMINAL, a tilt of the rail and one that does nothing."""

    name, path, timestep = "carts", "", H

    def __init__(self, n: int) -> None:
        self.nq = self.nv = self.nu = self.inputs = n
        self.planar = False
        self.joint_names = self.joints = self.urdf_changes = self.contact_names = ()
        self.actuator_names = tuple(f"motor {i}" for i in range(n))
        self.left_out = (SimpleNamespace(kind="tendon", name="rope", why="not modelled"),)
        made = [Parameter(f"{f}.{i}", f, 1.0, 0.2, 5.0, "log", "") for f in FIELDS for i in range(n)]
        self.parameters = (
            *made,
            Parameter("tilt", "tilt", 0.0, -2.0, 2.0, "linear", "m/s^2"),
            Parameter("bumper", "bumper", 0.0, 0.0, 1.0, "linear", ""),
        )
        layout = Layout(dimension=2, nbody=n, nv=n, ncontact=0, nplane=0, nact=n)
        places = [layout.mass(i) for i in range(n)]
        places += [layout.dof(i, field) for field in ("damping", "frictionloss") for i in range(n)]
        places += [layout.actuator(i) for i in range(n)]
        physical = np.zeros(layout.size)
        for field, at in zip(FIELDS, np.reshape(places, (4, n)), strict=True):
            physical[at] = NOMINAL[field]
        self.core = SimpleNamespace(**{
            "nbody": n, "nv": n, "P": physical, "layout": layout,
            "body_parent": np.full(n, -1), "con_bodyA": np.empty(0, int), "con_bodyB": np.empty(0, int),
            "con_law": np.empty(0, int), "con_type": np.empty(0, int), "nweight": 0, "ntie": 0,
            "jnt_type": np.zeros(n, int), "jnt_body": np.arange(n), "jnt_qadr": np.arange(n), "jnt_vadr": np.arange(n),
            "act_line": np.arange(n), "act_ctrl": np.tile([-np.inf, np.inf], (n, 1)),
            "wide_act": np.empty(0, int), "par_idx": np.array([*places, layout.gravity]),
            "par_ptr": np.array([*range(4 * n + 2), 4 * n + 1]), "ntendon": 0, "box_body": np.empty(0, int),
            "box_linear": np.empty((0, 3)), "box_quadratic": np.empty((0, 3)), "ellipsoid_body": np.empty(0, int),
            "ellipsoid_coef": np.empty((0, 19)), "tendon_ptr": np.zeros(1, int),
            "tendon_dof": np.empty(0, int), "lim_line": np.empty(0, int), "lim_lo": np.empty(0), "lim_hi": np.empty(0),
            **dict.fromkeys(("tie_type", "tie_A", "tie_B"), np.empty(0, int)),
        })  # fmt: skip
        self.layout, self.gravity, self.coordinate_names = layout, np.zeros(2), tuple(f"cart {i}" for i in range(n))

    def parameter_vector(self) -> np.ndarray:
        return np.array([p.nominal for p in self.parameters])

    def difference(self, q_from: np.ndarray, q_to: np.ndarray) -> np.ndarray:
        return q_to - q_from

    def integrate(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        return q + dq


class CartModel:
    """The part of ComplementarityModel that a fit uses."""

    dt, substeps, lanes = H, 1, 4

    def __init__(
        self, scene: CartScene, parameters: np.ndarray | None = None, observation: dict[str, float] | None = None
    ) -> None:
        self.scene, self.observation = scene, observation or {}
        self.parameters = scene.parameter_vector() if parameters is None else np.asarray(parameters)
        self.calls = 0

    @property
    def observer(self) -> Observation:
        return Observation.of(self.scene, self.dt)  # type: ignore[arg-type]

    def seen(self, log: Transitions) -> Transitions:
        return self.observer.states(log, self.observer.vector(self.observation))

    def with_parameters(self, theta: np.ndarray) -> CartModel:
        return CartModel(self.scene, theta)

    def with_settings(self, observation: dict[str, float]) -> CartModel:
        return CartModel(self.scene, self.parameters, observation)

    def for_log(self, dt: float) -> CartModel:
        return self

    def alternatives(self) -> dict[str, CartModel]:
        return {}

    def rivals(self) -> dict[str, CartModel]:
        return {}  # nothing slides

    def other_steppings(self) -> list[CartModel]:
        return []

    def to_config(self) -> dict[str, Any]:
        return {"carts": self.scene.nv, "parameters": self.parameters.tolist()}

    def predict(
        self, q: Any, v: Any, u: Any, theta: Any = None, jacobian: bool = False, parameter_jacobian: Any = None
    ) -> SimpleNamespace:
        n = self.scene.nv
        theta = self.parameters if theta is None else theta
        m, d, f, g = (theta[..., i * n : (i + 1) * n] * NOMINAL[name] for i, name in enumerate(FIELDS))
        force = g * u - d * v - f * np.tanh(v / WIDTH)
        v_next = v + H * (force / m - theta[..., 4 * n, None])
        found = None
        if jacobian:
            in_v = 1.0 - H * (d + f / WIDTH / np.cosh(v / WIDTH) ** 2) / m
            columns = {
                "mass": -force / m**2 * NOMINAL["mass"],
                "damping": -v / m * NOMINAL["damping"],
                "frictionloss": -np.tanh(v / WIDTH) / m * NOMINAL["frictionloss"],
                "gear": u / m * NOMINAL["gear"],
            }
            velocity = np.zeros((len(q), n, 3 * n + len(theta)))  # derivatives of v_next in q, v, u, theta
            cart = np.arange(n)
            velocity[:, cart, n + cart], velocity[:, cart, 2 * n + cart] = in_v, H * g / m
            for i, name in enumerate(FIELDS):
                velocity[:, cart, (3 + i) * n + cart] = H * columns[name]
            velocity[:, :, 7 * n] = -H
            position = H * velocity
            position[:, cart, cart] += 1.0
            wanted = np.concatenate([np.arange(3 * n), 3 * n + parameter_jacobian])
            found = np.concatenate([position, velocity], axis=1)[:, :, wanted]
        return SimpleNamespace(q_next=q + H * v_next, v_next=v_next, status=np.zeros(len(q), int), jacobian=found)

    def candidate_losses(self, theta: np.ndarray, windows: Windows) -> np.ndarray:
        self.calls += 1
        data, starts, horizon, scales = windows.data, windows.starts, windows.horizon, windows.scales
        losses = np.zeros((len(theta), len(starts)))
        for c, candidate in enumerate(theta):
            a, b = (x if x.ndim == 2 else x[c] for x in windows.begin(self.scene))
            for j in range(horizon):
                rows = starts + j
                step = self.predict(a, b, data.u[rows], candidate)
                a, b = step.q_next, step.v_next
                residual = np.hstack([(a - data.q_next[rows]) / scales.q, (b - data.v_next[rows]) / scales.v])
                losses[c] += huber_loss(residual, scales.huber).sum(axis=1) / horizon
        return losses

    def along(self, windows: Windows, theta: np.ndarray, *wanted: np.ndarray) -> Predicted:
        return along_by_steps(self, windows, theta, *wanted)


def record(model: CartModel, episodes: int, steps: int, seed: int = 0, noise: float = 0.0) -> Transitions:
    """A log of ``model`` under random control; ``noise`` [m/s] is a kick at the end of every step."""
    draw = np.random.default_rng(seed)
    rows: dict[str, list[np.ndarray]] = {name: [] for name in ("q", "v", "u", "q_next", "v_next")}
    for _ in range(episodes):
        q, v = draw.normal(size=(1, model.scene.nq)), draw.normal(size=(1, model.scene.nv))
        for _ in range(steps):
            u = draw.uniform(-1.0, 1.0, size=(1, model.scene.nu))
            step = model.predict(q, v, u)
            v_next = step.v_next + noise * draw.normal(size=v.shape)
            q_next = q + H * v_next
            for name, value in zip(rows, (q, v, u, q_next, v_next), strict=True):
                rows[name].append(value[0])
            q, v = q_next, v_next
    episode = np.repeat(np.arange(episodes), steps)
    return Transitions(**{name: np.array(value) for name, value in rows.items()}, dt=H, episode=episode)


@pytest.fixture(scope="session")
def carts() -> SimpleNamespace:
    """``carts.model(n)``, ``carts.truth(n, **scales)`` (a model with other parameters) and ``carts.record``."""

    def truth(n: int, **changes: float) -> CartModel:
        scene = CartScene(n)
        theta = scene.parameter_vector()
        for k, parameter in enumerate(scene.parameters):
            theta[k] = changes.get(parameter.name.replace(".", "_"), theta[k])
        return CartModel(scene, theta)

    return SimpleNamespace(model=lambda n=1: CartModel(CartScene(n)), truth=truth, record=record, Model=CartModel)


QUICK = Budget(trial_rounds=3, trial_population=16, search_rounds=4, search_population=16)


@pytest.fixture(scope="session")
def two_carts(carts: SimpleNamespace) -> Transitions:
    """A log of two carts: a motor at .7 of its strength, on a slope."""
    return carts.record(carts.truth(2, gear_1=0.7, tilt=0.4), episodes=20, steps=40, noise=1e-3)


@pytest.fixture(scope="session")
def whole_fit(carts: SimpleNamespace, two_carts: Transitions) -> cmbrl.FitResult:
    """The usual fit of that log, to compare others with."""
    return cmbrl.fit(carts.model(2), two_carts)


@pytest.fixture(scope="session")
def quick_fit(carts: SimpleNamespace, two_carts: Transitions) -> cmbrl.FitResult:
    """The same by ``QUICK``."""
    return cmbrl.fit(carts.model(2), two_carts, budget=QUICK)
