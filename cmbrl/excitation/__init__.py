"""Commands that tell most about a robot's parameters: ``commands`` draws them, ``search`` chooses among them."""

from __future__ import annotations

from cmbrl.excitation.search import Excitation, excite

__all__ = ["Excitation", "excite"]
