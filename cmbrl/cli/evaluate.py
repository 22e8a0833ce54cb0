"""``cmbrl evaluate``: the return of a policy in the real system and in a model, and the gap between them."""

from __future__ import annotations

import argparse
import json
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cmbrl.cli.argument_types import assignment, positive
from cmbrl.cli.options import MODEL_HELP, add_json, add_seed, add_smoothing, add_threads
from cmbrl.cli.parser import WIDTH
from cmbrl.errors import UserError
from cmbrl.runs import usable_cores
from cmbrl.text import parse_number, shortened

if TYPE_CHECKING:
    from cmbrl.envs.evaluation import Evaluation
    from cmbrl.envs.perturbation import Perturbation, Simulator
    from cmbrl.mdp import MDP
    from cmbrl.train.policies.saved import Trained

EXAMPLE = """
cmbrl evaluate runs/policy                      # in the real system and the model
cmbrl evaluate runs/policy --real --episodes 50 --json
cmbrl evaluate runs/policy --model runs/other_fit
cmbrl evaluate runs/policy --task hopper@payload:3 --real   # in another real system of that robot
cmbrl evaluate runs/walk --robustness --episodes 5
cmbrl evaluate runs/walk --simulator drake      # a second opinion on contact
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("policy", metavar="POLICY", help="the folder of a policy: a `cmbrl train` run")
    parser.add_argument("--model", metavar="M", help=f"only in this model: {MODEL_HELP}; with --real, in both")
    parser.add_argument(
        "--task",
        metavar="TASK",
        help="judge it in this task, whose real system is another one of the same robot, as hopper@payload:3 or a file",
    )
    parser.add_argument("--real", action="store_true", help="only in the real system")
    parser.add_argument("--episodes", type=positive, default=10, metavar="N", help="episodes in each (default 10)")
    parser.add_argument(
        "--perturb",
        action="append",
        default=[],
        type=assignment,
        metavar="NAME=VALUE",
        help="only in a real system that differs: friction=0.3, payload=3 [kg], push=0.5 [m/s every 2 s], delay=0.01 "
        "[s], contact_time=0.005 [s] of all contacts (repeatable)",
    )
    parser.add_argument(
        "--robustness", action="store_true", help="a table of failures by kind and level of such differences"
    )
    parser.add_argument(
        "--simulator",
        choices=("mujoco", "drake"),
        default="mujoco",
        help="what simulates the real system: MuJoCo, or Drake with contact of its own (default mujoco)",
    )
    add_smoothing(parser)
    add_threads(parser)
    add_seed(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    from cmbrl.envs.evaluation import evaluate_model, evaluate_real
    from cmbrl.envs.of_task import real_system
    from cmbrl.envs.perturbation import Perturbation, perturbed
    from cmbrl.envs.promised import lacking
    from cmbrl.train.models import REAL, check_model, load_model
    from cmbrl.train.policies.saved import Trained

    word = arguments.model
    if word == REAL:
        raise UserError("--model real: `real` is not a model; use --real")
    if word is not None:
        check_model(word)
    perturbation = _perturbation(arguments.perturb) if arguments.perturb else None
    if perturbation and arguments.robustness:
        raise UserError("--robustness has levels of its own: leave out --perturb")
    simulator = _simulator(arguments.simulator)
    if (perturbation or arguments.robustness or simulator) and word is not None:
        raise UserError("--perturb, --robustness and --simulator are of the real system: leave out --model")
    trained = Trained.load(arguments.policy, arguments.task)
    policy, task, mdp = trained.saved.policy, trained.task, trained.mdp
    found: dict[str, Evaluation] = {}
    if arguments.robustness:
        print(_robustness(trained, arguments, simulator))
        return
    if arguments.real or word is None:
        system, where = real_system(task), REAL if simulator is None else arguments.simulator
        if perturbation is not None or simulator is not None:
            system = perturbed(system, perturbation or Perturbation(), arguments.seed, simulator)
        found[where] = evaluate_real(policy, mdp, system, arguments.episodes, arguments.seed)
    if word is None and not (arguments.real or perturbation or simulator):
        word = trained.usual_model()
    told = ""
    if word is not None:
        model = load_model(word, task, arguments.smoothing, arguments.threads or usable_cores())
        found[word] = evaluate_model(policy, mdp, model, arguments.episodes, arguments.seed)
        if REAL in found:
            idle = evaluate_model(
                lambda o: o.new_zeros(len(o), mdp.actions), mdp, model, arguments.episodes, arguments.seed
            )
            told = _promise(lacking(found[REAL], found[word], idle), word, task.name)
    if arguments.json:
        places = {where: to_json(e, mdp) for where, e in found.items()}
        print(json.dumps({"policy": arguments.policy, "task": task.name, "in": places, "advice": told}, indent=2))
    else:
        print(_table(found, mdp.failure))
        if told:
            print(textwrap.fill(f"{arguments.policy}: {told}", WIDTH, subsequent_indent="  ", break_on_hyphens=False))


def _promise(lack: float, word: str, task: str) -> str:
    """What to do where the real system lacks a share of what the model ``word`` promised; empty where it is little."""
    from cmbrl.envs.promised import FAR
    from cmbrl.train.models import NOMINAL

    if lack <= FAR:
        return ""
    told = f"the real system earns {100 * lack:.0f} % less than {word} promises"
    if word == NOMINAL:
        return f"{told}, it is not as its file: fit a log of it (cmbrl record {task}, cmbrl fit), and train on the fit"
    return (
        f"{told}, which lacks something: record what the policy does (cmbrl export --torchscript, cmbrl record {task} "
        f"--policy), see where {word} errs there (cmbrl error), and fit both logs"
    )


def _perturbation(given: Sequence[tuple[str, str]]) -> Perturbation:
    from cmbrl.envs.perturbation import Perturbation

    values = {}
    for name, value in given:
        try:
            values[name] = float(parse_number(value))
        except ValueError as error:
            raise UserError(f"--perturb {name}={shortened(value)}: {error}") from None
    return Perturbation.of(values)


def _simulator(name: str) -> Simulator | None:
    """What makes another simulator of MuJoCo's system; None for MuJoCo itself."""
    if name == "mujoco":
        return None
    from cmbrl.envs.drake import DrakeSystem

    return DrakeSystem


def _robustness(trained: Trained, arguments: argparse.Namespace, simulator: Simulator | None) -> str:
    """A line a level: how many episodes failed, their return, and what the task measures."""
    from cmbrl.envs.evaluation import evaluate_real
    from cmbrl.envs.of_task import real_system
    from cmbrl.envs.perturbation import LEVELS, Perturbation, perturbed
    from cmbrl.table import Table

    system, mdp, episodes, seed = real_system(trained.task), trained.mdp, arguments.episodes, arguments.seed
    perturbed(system, Perturbation(), seed, simulator)  # raises where nothing can be perturbed
    cases = [("as it is", None), *((name, level) for name, levels in LEVELS.items() for level in levels)]
    found = []
    for name, level in cases:
        try:
            other = perturbed(system, Perturbation.of({} if level is None else {name: level}), seed, simulator)
        except UserError:  # pushes of a robot without a free root, delays beyond a control step
            continue
        e = evaluate_real(trained.saved.policy, mdp, other, episodes, seed)
        found.append({"perturbation": name, "level": level, "episodes": episodes, **to_json(e, mdp)})
    if arguments.json:
        return json.dumps({"policy": str(trained.folder), "task": trained.task.name, "levels": found}, indent=2)
    measured = [name for name, value in found[0].items() if name.startswith("mean_")]
    rows = [
        [f["perturbation"], f["level"], f[mdp.failure], f["return"]["mean"], *(f[name] for name in measured)]
        for f in found
    ]
    columns = ["perturbation", "level", f"{mdp.failure} of {episodes}", "return", *measured]
    where = "the real system" if simulator is None else arguments.simulator
    return Table(f"{trained.folder} in {where}", columns, rows).text()


def to_json(e: Evaluation, mdp: MDP) -> dict[str, Any]:
    """Means are over steps, then over episodes; ``reward_terms`` are those that the reward adds."""
    from cmbrl.mdp import Total

    failure, terms = mdp.failure, mdp.reward.terms if isinstance(mdp.reward, Total) else ()
    told = {name: x for name, x in e.info.items() if name not in terms}
    means = {f"mean_{name}": float(x.mean()) for name, x in told.items()}
    return {
        failure: int(e.terminated.sum()),
        **means,
        "return": {"mean": float(e.returns.mean()), "standard_deviation": float(e.returns.std())},
        "reward_terms": {name: float(e.info[name].mean()) for name in terms if name in e.info},
        "length": {"mean": float(e.lengths.mean())},
        "returns": e.returns.tolist(),
        "lengths": e.lengths.tolist(),
        "episodes": [
            {failure: bool(e.terminated[k]), **{f"mean_{name}": float(x[k]) for name, x in told.items()}}
            for k in range(len(e.returns))
        ],
    }


def _table(found: dict[str, Evaluation], failure: str) -> str:
    """Return and length of every episode, then means, standard deviations, and real - model."""
    width = 24
    heads = [where if len(where) < width else f"...{where[4 - width :]}" for where in found]
    columns = list(found.values())
    rows = [("episode", heads), ("", ["return, length"] * len(columns))]
    for k in range(len(columns[0].returns)):
        rows.append((str(k), [f"{e.returns[k]:.4g}, {e.lengths[k]:d}" for e in columns]))
    for name, measure in (("mean", np.mean), ("st.dev.", np.std)):
        rows.append((name, [f"{measure(e.returns):.4g}, {measure(e.lengths):.0f}" for e in columns]))
    rows.append((failure, [str(int(e.terminated.sum())) for e in columns]))
    for name in columns[0].info:
        rows.append((f"mean {name}", [f"{e.info[name].mean():.4g}" if name in e.info else "" for e in columns]))
    first = max(8, *(len(name) for name, _ in rows))
    lines = [f"{name:>{first}s}" + "".join(f"{cell:>{width}s}" for cell in cells) for name, cells in rows]
    if len(columns) == 2:
        real, model = (float(e.returns.mean()) for e in columns)
        lines.append(f"real - model: {real - model:+.4g}" + (f" ({real / model:.0%})" if model > 0 else ""))
    return "\n".join(lines)
