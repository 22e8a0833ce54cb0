"""``cmbrl export``: a policy as ONNX or TorchScript, for other programs."""

from __future__ import annotations

import argparse
from io import BytesIO
from typing import Any

import numpy as np

from cmbrl.errors import UserError
from cmbrl.files import check_writable, write_bytes

EXAMPLE = """
cmbrl export runs/policy --onnx policy.onnx
cmbrl export runs/policy --torchscript policy.pt
cmbrl export runs/walk --onnx walk.onnx --controller walk.npz
cmbrl record hopper --steps 1000 --behaviour policy --policy policy.pt --out on_policy.npz
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("policy", metavar="POLICY", help="the folder of a policy: a `cmbrl train` run")
    parser.add_argument("--onnx", metavar="FILE", help="write ONNX: float32 observations (batch, n) to actions")
    parser.add_argument("--torchscript", metavar="FILE", help="write TorchScript, for `cmbrl record --policy`")
    parser.add_argument(
        "--controller",
        metavar="FILE",
        help="write what a program needs besides the net, as .npz: the order of observations, names, the control step, "
        "and what makes controls of actions (policies that walk or imitate)",
    )


def run(arguments: argparse.Namespace) -> None:
    files = [path for path in (arguments.onnx, arguments.torchscript) if path]
    if not files and not arguments.controller:
        raise UserError("nothing to write: give --onnx FILE, --torchscript FILE, --controller FILE, or several")
    for path in (*files, *([arguments.controller] if arguments.controller else [])):
        check_writable(path)

    from cmbrl.train.policies.export import export_onnx, export_torchscript
    from cmbrl.train.policies.file import load_policy
    from cmbrl.train.running.texts import last_actions_text

    policy = load_policy(arguments.policy).policy
    parts = _controller(arguments.policy, arguments.controller) if arguments.controller else {}
    if arguments.onnx:
        export_onnx(policy, arguments.onnx)
    if arguments.torchscript:
        export_torchscript(policy, arguments.torchscript)
    shape, told = policy.architecture, ""
    if shape.last_actions:
        order = ", the newest first" if shape.last_actions > 1 else ""
        told = f", which end with the {last_actions_text(shape.last_actions)}{order} (0 before an episode)"
    for path in files:
        print(f"{path}: observations (batch, {shape.observations}){told}")
    if parts:
        content = BytesIO()
        np.savez_compressed(content, **parts)
        write_bytes(arguments.controller, content.getvalue())
        sizes = zip(parts["observation_sizes"], parts["observation_parts"], strict=True)
        print(f"{arguments.controller}: observations are {', '.join(f'{size} {name}' for size, name in sizes)}")


def _controller(folder: str, path: str) -> dict[str, Any]:
    """Of the policy in ``folder``; raises UserError where its task tells nothing, and for another kind of file."""
    from cmbrl.train.policies.saved import Trained

    if not path.endswith(".npz"):
        raise UserError(f"--controller {path}: it is an npz: name it FILE.npz")
    mdp = Trained.load(folder).mdp
    if mdp.controller is None:
        raise UserError(
            f"--controller: the task of {folder} does not tell the order of its observations: give its MDP a "
            "`controller`, or write a program after its `observe` and `act`"
        )
    parts = dict(mdp.controller())
    if mdp.last_actions:
        parts["observation_parts"] = np.append(parts["observation_parts"], "last_actions_newest_first")
        parts["observation_sizes"] = np.append(parts["observation_sizes"], mdp.last_actions * mdp.actions)
    return parts
