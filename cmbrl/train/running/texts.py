"""What a training run says of itself, in a few words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cmbrl.train.policies.limits import PINNED


def commands_text(told: Mapping[str, Any]) -> str:
    """What a run's ``commands`` are, in words.

    >>> commands_text({"delay": 0.016, "lag": 0.02, "last_actions": 5})
    'commands 16 ms late with a lag of 20 ms, as in the model; the policy observes its last 5 actions'
    """
    late = f"commands {1e3 * told['delay']:.3g} ms late with a lag of {1e3 * told['lag']:.3g} ms, as in the model"
    count = told["last_actions"]
    seen = "too short for the policy to observe any action"
    if count:
        seen = f"the policy observes its {last_actions_text(count)}"
    return f"{late}; {seen}"


def last_actions_text(count: int) -> str:
    """Some of the last actions, counted.

    >>> last_actions_text(1), last_actions_text(2)
    ('last action', 'last 2 actions')
    """
    return "last action" if count == 1 else f"last {count} actions"


def progress_text(row: Mapping[str, float]) -> str:
    """A row in a few words: return, gradient norm and variance, steps, seconds, as far as they were measured.

    Where episodes begin and end anywhere, as those of motions do, a return says little without its steps.

    >>> progress_text({"return": 312.4, "length": 498.7, "gradient_norm": 0.71, "steps": 204800, "seconds": 12.3})
    'return 312.4 in 499 steps, gradient 0.71, 205k model steps, 12 s'
    """
    parts = [f"return {row['return']:.4g}"] if "return" in row else []
    if parts and "length" in row:
        parts[0] += f" in {row['length']:.0f} steps"
    if "gradient_norm" in row:
        variance = f" (variance {row['gradient_variance']:.2g})" if "gradient_variance" in row else ""
        parts.append(f"gradient {row['gradient_norm']:.2g}{variance}")
    if row.get("transitions"):
        parts.append(f"{_short(row['transitions'])} real steps")
    if row.get("steps"):
        parts.append(f"{_short(row['steps'])} model steps")
    return ", ".join([*parts, f"{row['seconds']:.0f} s"])


def pinned_text(row: Mapping[str, float]) -> str:
    """What the last row says of actions at their limits; empty where they are few, or were not counted.

    >>> pinned_text({"at_limits": 0.97})[:72]
    '97 % of its actions are at their limits, from where it learns little: if'
    >>> pinned_text({"at_limits": 0.3})
    ''
    """
    share = row.get("at_limits", 0.0)
    if share < PINNED:
        return ""
    return (
        f"{100 * share:.0f} % of its actions are at their limits, from where it learns little: if it earns too little, "
        f"train longer (--iterations)"
    )


def _short(count: float) -> str:
    """A count in at most four characters and a unit."""
    for size, unit in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if count >= size:
            return f"{count / size:.3g}{unit}"
    return f"{count:.0f}"
