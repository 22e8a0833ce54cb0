"""Solvers by name, with the packages they need; each is imported on first use."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from cmbrl.contact.solvers.fixed_point import DeSaxce, Relaxed
from cmbrl.contact.solvers.formulation import pyramid, second_order_cone
from cmbrl.contact.solvers.protocol import Law, Solver
from cmbrl.errors import UserError, did_you_mean

HERE = "cmbrl.contact.solvers"
QPSOLVERS = {  # its name -> its package
    "clarabel": "clarabel", "daqp": "daqp", "highs": "highspy", "osqp": "osqp", "piqp": "piqp",
    "proxqp": "proxsuite", "quadprog": "quadprog", "scs": "scs",
}  # fmt: skip


@dataclass(frozen=True)
class Entry:
    """``make(name, **options)``; ``needs``: modules that must be importable; ``install``: arguments of pip."""

    law: Law
    make: Callable[..., Solver]
    needs: tuple[str, ...] = ()
    install: str = ""

    @property
    def installed(self) -> bool:
        """Whether all needed modules can be imported."""
        return all(find_spec(module) for module in self.needs)


def available(law: Law | None = None) -> list[str]:
    """Names of the installed solvers of one law, or of all."""
    return [name for name, entry in ENTRIES.items() if entry.installed and law in (None, entry.law)]


def get(name: str, **options: Any) -> Solver:
    """The solver of this name; ``options`` are its own settings (e.g. ``sweeps`` of "pgs").

    Raises UserError for an unknown name or a missing package.
    """
    if name not in ENTRIES:
        raise UserError(f"unknown contact solver {name!r}; {did_you_mean(name, ENTRIES)}")
    entry = ENTRIES[name]
    if not entry.installed:
        raise UserError(f"contact solver {name!r} is not installed: pip install {entry.install}")
    return entry.make(name, **options)


def _class(module: str, cls: str, **fixed: Any) -> Callable[..., Solver]:
    return lambda name, **options: getattr(import_module(f"{HERE}.{module}"), cls)(name=name, **fixed, **options)


def _program(kind: type[Relaxed] | type[DeSaxce], module: str, formulate: Any = pyramid, **fixed: Any) -> Any:
    def make(name: str, **options: Any) -> Solver:
        lay_out = import_module(f"{HERE}.{module}").lay_out
        return kind(name, partial(formulate, **options), partial(lay_out, **fixed) if fixed else lay_out)

    return make


ENTRIES: dict[str, Entry] = {
    "ours": Entry("exact", _class("native", "InteriorPoint")),
    "ours softened": Entry("softened", _class("native", "InteriorPoint", law="softened")),
    "pgs": Entry("exact", _class("pgs", "ProjectedGaussSeidel")),
    "admm": Entry("exact", _class("admm", "AlternatingDirections")),
    "pinocchio admm": Entry("exact", _class("pinocchio", "Pinocchio", method="ADMM"), ("pinocchio",), "pin"),
    "pinocchio pgs": Entry("exact", _class("pinocchio", "Pinocchio", method="PGS"), ("pinocchio",), "pin"),
    "pinocchio admm convex": Entry(
        "convex", _class("pinocchio", "Pinocchio", method="ADMM", law="convex"), ("pinocchio",), "pin"
    ),
    "convex": Entry("convex", _program(Relaxed, "daqp"), ("daqp",), "daqp"),
    "desaxce": Entry("exact", _program(DeSaxce, "daqp"), ("daqp",), "daqp"),
    "proxsuite": Entry("convex", _program(Relaxed, "proxsuite"), ("proxsuite",), "proxsuite"),
    "desaxce proxsuite": Entry("exact", _program(DeSaxce, "proxsuite"), ("proxsuite",), "proxsuite"),
    "clarabel": Entry("convex", _program(Relaxed, "clarabel", second_order_cone), ("clarabel",), "clarabel"),
    "desaxce clarabel": Entry("exact", _program(DeSaxce, "clarabel", second_order_cone), ("clarabel",), "clarabel"),
    **{
        f"cvxpy {solver.lower()}": Entry(
            "convex", _program(Relaxed, "through_cvxpy", second_order_cone, solver=solver), ("cvxpy", solver.lower()),
            f"cvxpy {solver.lower()}",
        )
        for solver in ("CLARABEL", "SCS")
    },
    **{
        f"qpsolvers {solver}": Entry(
            "convex", _program(Relaxed, "through_qpsolvers", solver=solver), ("qpsolvers", package),
            f"qpsolvers {package}",
        )
        for solver, package in QPSOLVERS.items()
    },
}  # fmt: skip
