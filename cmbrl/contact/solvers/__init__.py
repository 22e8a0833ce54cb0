"""Contact solvers with one interface; ``cmbrl.contact.certificates`` scores what they return.

``available()`` lists those whose packages are installed; ``get(name)`` makes one.
"""

from __future__ import annotations

from cmbrl.contact.solvers.protocol import Law, Solution, Solver
from cmbrl.contact.solvers.registry import available, get

__all__ = ["Law", "Solution", "Solver", "available", "get"]
