"""From a log to physical parameters: ``cmbrl.fit(model, data)``, in order of reading

``fit``            the whole procedure, top to bottom
``space``          named, bounded, transformed parameters; ``gauge``: which mass stands for the unit of force
``loss``           prediction errors of many candidates, Gauss-Newton equations; ``objective``: the same with the prior
``random_search``  candidates around the best so far; ``cma`` and ``gauss_newton``: the rivals, and the polish
``parsimony``      no more parameters than held-out episodes ask for; ``forecast``: what a group of them promises
``identify``       intervals, and what the data cannot tell
``state``          a killed fit goes on; ``result``: what comes out, and its folder

The package can be called, so that ``cmbrl.fit`` is both the function and the place of its parts.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

from cmbrl.fit.fit import Budget, fit
from cmbrl.fit.result import FitResult, FittedParameter

__all__ = ["Budget", "FitResult", "FittedParameter", "fit"]


class _CallablePackage(ModuleType):
    def __call__(self, *args: Any, **kwargs: Any) -> FitResult:
        return fit(*args, **kwargs)


sys.modules[__name__].__class__ = _CallablePackage
