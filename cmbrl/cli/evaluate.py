"""``cmbrl evaluate``: what a policy earns in the real system, and in a model, so that the gap shows."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cmbrl.cli.models import (
    MODEL_HELP,
    REAL,
    add_smoothing,
    check_model,
    load_model,
    real_system,
    saved_policy,
)
from cmbrl.cli.options import add_json, add_seed, add_threads, positive
from cmbrl.errors import UserError
from cmbrl.runs import usable_cores

if TYPE_CHECKING:
    from cmbrl.envs.evaluation import Evaluation

EXAMPLE = """
cmbrl evaluate runs/policy                            in the real system, and in the model it was trained on
cmbrl evaluate runs/policy --real --episodes 50 --json
cmbrl evaluate runs/policy --model runs/other_fit
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("policy", metavar="POLICY", help="the folder of a policy: a `cmbrl train` run")
    parser.add_argument("--model", metavar="M", help=f"only in this model: {MODEL_HELP}; with --real, in both")
    parser.add_argument("--real", action="store_true", help="only in the real system")
    parser.add_argument("--episodes", type=positive, default=10, metavar="N", help="episodes in each (default 10)")
    add_smoothing(parser)
    add_threads(parser)
    add_seed(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    if arguments.model is not None:
        check_model(arguments.model)
        if arguments.model == REAL:
            raise UserError("--model real: the real system is no model: give --real")

    from cmbrl.envs.evaluation import evaluate_model, evaluate_real

    saved, task, mdp = saved_policy(arguments.policy)
    word = model_word(Path(arguments.policy), saved.about, arguments.model, arguments.real)
    found: dict[str, Evaluation] = {}
    if arguments.real or arguments.model is None:
        system = real_system(task)
        found[REAL] = evaluate_real(saved.policy, mdp, system, arguments.episodes, arguments.seed)
    if word is not None:
        model = load_model(word, task, arguments.smoothing, arguments.threads or usable_cores())
        found[word] = evaluate_model(saved.policy, mdp, model, arguments.episodes, arguments.seed)
    if arguments.json:
        print(json.dumps({"policy": arguments.policy, "task": task.name, **_to_json(found)}, indent=2))
    else:
        print(_text(found))


def model_word(policy: Path, about: dict[str, Any], named: str | None, real_only: bool) -> str | None:
    """The model to try the policy in: the one named, else the one it was trained on unless ``real_only``.

    An algorithm that fits its model has left that in the policy's folder.

    Raises UserError when that one is not there any more.
    """
    word = named
    if named is None and not real_only:
        own = policy / "fit"
        word = str(own) if own.is_dir() else about.get("model")
    if word is None or word == REAL:
        return None
    check_model(word)
    return str(word)


def _to_json(found: dict[str, Evaluation]) -> dict[str, Any]:
    return {
        "in": {
            where: {
                "return": {"mean": float(e.returns.mean()), "standard_deviation": float(e.returns.std())},
                "length": {"mean": float(e.lengths.mean())},
                "returns": e.returns.tolist(),
                "lengths": e.lengths.tolist(),
            }
            for where, e in found.items()
        }
    }


def _text(found: dict[str, Evaluation]) -> str:
    """A table of episodes, and below it means and the gap between the real system and the model."""
    width = max(22, *(len(where) + 2 for where in found))
    lines = [f"{'episode':>8s}" + "".join(f"{where:>{width}s}" for where in found)]
    lines += [f"{'':8s}" + f"{'return, length':>{width}s}" * len(found)]
    for k in range(len(next(iter(found.values())).returns)):
        cells = "".join(f"{f'{e.returns[k]:.4g}, {e.lengths[k]:d}':>{width}s}" for e in found.values())
        lines.append(f"{k:8d}{cells}")
    for name, measure in (("mean", "mean"), ("st.dev.", "std")):
        row = [f"{getattr(e.returns, measure)():.4g}, {getattr(e.lengths, measure)():.0f}" for e in found.values()]
        lines.append(f"{name:>8s}" + "".join(f"{cell:>{width}s}" for cell in row))
    if len(found) == 2:
        real, model = (float(e.returns.mean()) for e in found.values())
        lines.append(f"real less model: {real - model:+.4g}" + (f" ({real / model:.0%})" if model > 0 else ""))
    return "\n".join(lines)
