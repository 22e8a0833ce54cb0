"""Derivatives of contact steps by other solvers: one vector-Jacobian product w' dv'/dv_free, solve included.

All of them differentiate the convex relaxation, with "round" cones or with a friction "pyramid".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, Literal

import numpy as np

from cmbrl.contact.problem import Array, ContactProblem
from cmbrl.contact.solvers.formulation import Program, pyramid, second_order_cone

Product = Callable[[float], Array]
FORWARD = 1e-10  #: tolerance of ProxQP's solve and of its backward solve
DIFFERENCES = (1e-2, 1e-4, 1e-6, 1e-8)  #: steps of finite differences, relative to the problem's speed


@dataclass(frozen=True)
class SolverGradient:
    """A way to differentiate a solve.

    law: that it differentiates. lay_out: prepares a problem and a cotangent w (nv,); the function it returns takes one
    of ``settings``, which trade time for accuracy, and returns the product (nv,). meaning: of the settings.
    """

    name: str
    law: Literal["exact", "round", "pyramid"]
    lay_out: Callable[[ContactProblem, Array], Product]
    settings: Sequence[float]
    meaning: str


def solver_gradients() -> list[SolverGradient]:
    """Those whose packages are installed."""
    damping, tolerances = (1e-4, 1e-6, 1e-8, 1e-10), (1e-3, 1e-5, 1e-7, 1e-9)
    every = {
        "daqp": [SolverGradient("DAQP, central differences", "pyramid", _differences, DIFFERENCES, "step")],
        "proxsuite": [
            SolverGradient("ProxQP, own backward pass", "pyramid", _proxqp, damping, "damping"),
            SolverGradient("ProxQP, QPLayer for torch", "pyramid", _proxqp_layer, damping, "damping"),
        ],
        "cvxpylayers": [SolverGradient("cvxpylayers", "round", _cvxpylayers, tolerances, "tolerance")],
    }
    return [one for package, found in every.items() if find_spec(package) for one in found]


def _differences(problem: ContactProblem, w: Array) -> Product:
    """Central differences of DAQP, one call for each of 2 nv solves."""
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
    """w for the program's variable, which ends with the velocities of compliant rows, if any."""
    return np.concatenate([w, np.zeros(len(program.f) - len(w))])


def _in_v_free(program: Program, in_f: Array, w: Array) -> Array:
    """From the derivative in f = -H v_free to the derivative in v_free."""
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
    none, upper = torch.empty(0, dtype=torch.float64), torch.full_like(lower, 1e20)

    def solve(f: Any, damping: float) -> Any:
        layer = QPFunction(eps=FORWARD, eps_backward=FORWARD, rho_backward=damping, mu_backward=damping)
        return layer(H, f, none, none, C, lower, upper)[0][0]

    return _by_torch(program, w, solve)


def _cvxpylayers(problem: ContactProblem, w: Array) -> Product:
    import cvxpy as cp
    from cvxpylayers.torch import CvxpyLayer

    program = second_order_cone(problem)
    root, rows = np.linalg.cholesky(program.H).T, program.J.shape[1]
    x, linear = cp.Variable(len(program.f)), cp.Parameter(len(program.f))
    c = program.C @ x - program.offset
    cones: list[cp.Constraint] = [cp.SOC(c[k], c[k + 1 : k + rows]) for k in range(0, len(program.C), rows)]
    cost = cp.Minimize(cp.sum_squares(root @ x) / 2 + linear @ x)
    layer = CvxpyLayer(cp.Problem(cost, cones), [linear], [x])

    def solve(f: Any, tolerance: float) -> Any:
        tolerances = dict.fromkeys(("tol_feas", "tol_gap_abs", "tol_gap_rel"), tolerance)
        return layer(f, solver_args={"solve_method": "Clarabel", "mode": "dense", **tolerances})[0]

    return _by_torch(program, w, solve)


def _by_torch(program: Program, w: Array, solve: Callable[[Any, float], Any]) -> Product:
    """Backward through ``solve``: linear term f, setting -> x, both tensors."""
    import torch

    f, cotangent = torch.from_numpy(program.f).requires_grad_(), torch.from_numpy(_cotangent(program, w))

    def product(setting: float) -> Array:
        before = torch.get_default_dtype()
        torch.set_default_dtype(torch.float64)  # QPLayer creates its gradients in the default type
        try:
            (in_f,) = torch.autograd.grad(solve(f, setting), f, cotangent)
        finally:
            torch.set_default_dtype(before)
        return _in_v_free(program, in_f.numpy(), w)

    return product
