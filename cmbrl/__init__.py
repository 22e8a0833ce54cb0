"""Contact models from logged transitions, and policies trained on them.

>>> import cmbrl
>>> scene = cmbrl.Scene.from_mjcf("hopper.xml")                   # the world
>>> model = cmbrl.ComplementarityModel(scene)                     # how it moves
>>> data = cmbrl.Transitions.load("hopper.npz")                   # the log
>>> result = cmbrl.fit(model, data, seed=0)                       # result.report: how well it explains the log
>>> q_next, v_next = result.model.step(q, v, u)                   # torch float64, differentiable, batch first

Names load on first use, so that ``cmbrl --help`` does not wait for torch.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cmbrl.contact.smoothing import ABS, Barrier, Exact, Gaussian, Relaxed
    from cmbrl.data.transitions import Transitions
    from cmbrl.errors import UserError
    from cmbrl.fitting.fit import fit
    from cmbrl.models.complementarity import ComplementarityModel
    from cmbrl.scene import Scene

_HOME = {
    "ABS": "cmbrl.contact.smoothing",
    "Barrier": "cmbrl.contact.smoothing",
    "ComplementarityModel": "cmbrl.models.complementarity",
    "Exact": "cmbrl.contact.smoothing",
    "Gaussian": "cmbrl.contact.smoothing",
    "Relaxed": "cmbrl.contact.smoothing",
    "Scene": "cmbrl.scene",
    "Transitions": "cmbrl.data.transitions",
    "UserError": "cmbrl.errors",
    "fit": "cmbrl.fitting.fit",
}

__all__ = [
    "ABS",
    "Barrier",
    "ComplementarityModel",
    "Exact",
    "Gaussian",
    "Relaxed",
    "Scene",
    "Transitions",
    "UserError",
    "__version__",
    "fit",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        value = getattr(import_module(_HOME[name]), name)
    elif name == "__version__":
        from importlib.metadata import version

        value = version("cmbrl")
    else:
        raise AttributeError(f"module 'cmbrl' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
