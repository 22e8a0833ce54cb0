"""Everyone who can differentiate a contact step here: one vector-Jacobian product w' dv'/dv_free, solve included.

A rival is laid out for a problem and a cotangent w (nv,) and returns the product (nv,) for a setting that trades time
for accuracy. ``law``: whose derivative it is, "exact", or the relaxation with "round" cones or with a "pyramid".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Literal

import numpy as np

from cmbrl.contact.problem import Array, ContactProblem
from cmbrl.contact.solvers.formulation import Program, pyramid, second_order_cone
from cmbrl.contact.solvers.native import Batch, solve

Product = Callable[[float], Array]
FORWARD = 1e-10  #: tolerance of ProxQP's solve and of its backward solve


@dataclass(frozen=True)
class Rival:
    """``settings``: what the product is called with, one after the other; ``meaning`` says what they are."""

    name: str
    law: Literal["exact", "round", "pyramid"]
    lay_out: Callable[[ContactProblem, Array], Product]
    settings: Sequence[float]
    meaning: str


def rivals() -> list[Rival]:
    """Those that are installed."""
    steps, damping, tolerances = (1e-2, 1e-4, 1e-6, 1e-8), (1e-4, 1e-6, 1e-8, 1e-10), (1e-3, 1e-5, 1e-7, 1e-9)
    out = [
        Rival("ours, implicit", "exact", _implicit, (1e-4, 1e-6, 1e-8, 1e-11), "tolerance"),
        Rival("ours, implicit, softened", "exact", _softened, (1e-2, 1e-4, 1e-6, 1e-8), "kappa / (speed^2 mass)"),
        Rival("ours, central differences", "exact", _batch_differences, steps, "step / speed"),
    ]
    if find_spec("daqp"):
        out.append(Rival("daqp, central differences", "pyramid", _differences, steps, "step / speed"))
    if find_spec("proxsuite"):
        out += [
            Rival("proxqp, its own backward", "pyramid", _proxqp, damping, "damping of the backward solve"),
            Rival("proxqp, torch layer", "pyramid", _proxqp_layer, damping, "damping of the backward solve"),
        ]
    if find_spec("cvxpylayers"):
        out.append(Rival("cvxpylayers", "round", _cvxpylayers, tolerances, "tolerance"))
    return out


def _implicit(problem: ContactProblem, w: Array) -> Product:
    """The whole matrix by the implicit function theorem, though only a product is asked for."""
    native = Batch.of([problem]).native(derivative=True)

    def product(tolerance: float) -> Array:
        native.solve(tolerance)
        return w @ native.results["derivative"][0]

    return product


def _softened(problem: ContactProblem, w: Array) -> Product:
    """The same of the softened law: its error here is the bias of kappa, not a mistake in differentiating."""
    native = Batch.of([problem]).native(derivative=True)
    energy = problem.speed**2 / float(np.diag(problem.delassus()).max())

    def product(kappa: float) -> Array:
        native.solve(1e-11, np.array([kappa * energy]))
        return w @ native.results["derivative"][0]

    return product


def _batch_differences(problem: ContactProblem, w: Array) -> Product:
    """Central differences of ours, all 2 nv solves in one call."""
    one, nv = Batch.of([problem]), len(w)
    held = {name: np.repeat(getattr(one, name), 2 * nv, axis=0) for name in ("M", "J", "b", "mu", "R")}

    def product(step: float) -> Array:
        shift = step * problem.speed * np.vstack([np.eye(nv), -np.eye(nv)])
        ends = solve(Batch(v_free=problem.v_free + shift, **held)).v @ w
        return (ends[:nv] - ends[nv:]) / (2 * step * problem.speed)

    return product


def _differences(problem: ContactProblem, w: Array) -> Product:
    """Central differences of DAQP, a call for each of 2 nv solves."""
    import daqp

    program = pyramid(problem)
    H, C, lower, nv = program.H, np.ascontiguousarray(program.C), program.offset, len(w)
    upper, sense = np.full(len(C), 1e30), np.zeros(len(C), dtype=np.int32)

    def product(step: float) -> Array:
        out = np.empty(nv)
        for k in range(nv):
            shift = step * H[:, k]
            ends = [daqp.solve(H, program.f + s, C, upper, lower, sense, primal_tol=1e-13)[0] for s in (-shift, shift)]
            out[k] = w @ (ends[0] - ends[1])[:nv] / (2 * step)
        return out

    return product


def _cotangent(program: Program, w: Array) -> Array:
    """w for the program's variable, which may have the velocities of compliant rows behind it."""
    return np.concatenate([w, np.zeros(len(program.f) - len(w))])


def _in_v_free(program: Program, in_f: Array, w: Array) -> Array:
    """From the derivative in f = -H v_free to that in v_free."""
    return -(program.H @ in_f)[: len(w)]


def _proxqp(problem: ContactProblem, w: Array) -> Product:
    from proxsuite import proxqp

    program = pyramid(problem)
    n, m = len(program.f), len(program.C)
    cotangent, upper = np.concatenate([_cotangent(program, w), np.zeros(m)]), np.full(m, 1e20)

    def product(damping: float) -> Array:
        qp = proxqp.dense.QP(n, 0, m)
        qp.settings.eps_abs = qp.settings.eps_duality_gap_abs = FORWARD
        qp.settings.eps_rel = qp.settings.eps_duality_gap_rel = 0.0
        qp.settings.check_duality_gap = True
        qp.init(program.H, program.f, None, None, program.C, program.offset, upper)
        qp.solve()
        proxqp.dense.compute_backward(qp, cotangent, FORWARD, damping, damping)
        return _in_v_free(program, qp.model.backward_data.dL_dg, w)

    return product


def _proxqp_layer(problem: ContactProblem, w: Array) -> Product:
    import torch
    from proxsuite.torch.qplayer import QPFunction

    program = pyramid(problem)
    H, C, lower = (torch.from_numpy(np.ascontiguousarray(x)) for x in (program.H, program.C, program.offset))
    f = torch.from_numpy(program.f).requires_grad_()
    none, upper = torch.empty(0, dtype=torch.float64), torch.full_like(lower, 1e20)
    cotangent = torch.from_numpy(_cotangent(program, w))

    def product(damping: float) -> Array:
        before = torch.get_default_dtype()
        torch.set_default_dtype(torch.float64)  # the layer makes its gradients in the default type
        try:
            layer = QPFunction(eps=FORWARD, eps_backward=FORWARD, rho_backward=damping, mu_backward=damping)
            x = layer(H, f, none, none, C, lower, upper)[0][0]
            (in_f,) = torch.autograd.grad(x, f, cotangent)
        finally:
            torch.set_default_dtype(before)
        return _in_v_free(program, in_f.numpy(), w)

    return product


def _cvxpylayers(problem: ContactProblem, w: Array) -> Product:
    import cvxpy as cp
    import torch
    from cvxpylayers.torch import CvxpyLayer

    program = second_order_cone(problem)
    root, rows = np.linalg.cholesky(program.H).T, program.J.shape[1]
    x, linear = cp.Variable(len(program.f)), cp.Parameter(len(program.f))
    c = program.C @ x - program.offset
    cones: list[cp.Constraint] = [cp.SOC(c[k], c[k + 1 : k + rows]) for k in range(0, len(program.C), rows)]
    cost = cp.Minimize(cp.sum_squares(root @ x) / 2 + linear @ x)
    layer = CvxpyLayer(cp.Problem(cost, cones), [linear], [x])
    f, cotangent = torch.from_numpy(program.f).requires_grad_(), torch.from_numpy(_cotangent(program, w))

    def product(tolerance: float) -> Array:
        options = {
            "solve_method": "Clarabel",
            "mode": "dense",
            "tol_feas": tolerance,
            "tol_gap_abs": tolerance,
            "tol_gap_rel": tolerance,
        }
        (value,) = layer(f, solver_args=options)
        (in_f,) = torch.autograd.grad(value, f, cotangent)
        return _in_v_free(program, in_f.numpy(), w)

    return product
