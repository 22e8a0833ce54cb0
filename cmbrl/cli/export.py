"""``cmbrl export``: a policy as ONNX or TorchScript, for other programs."""

from __future__ import annotations

import argparse

from cmbrl.errors import UserError
from cmbrl.files import check_writable

EXAMPLE = """
cmbrl export runs/policy --onnx policy.onnx
cmbrl export runs/policy --torchscript policy.pt
cmbrl record hopper --steps 1000 --behaviour policy --policy policy.pt --out on_policy.npz
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("policy", metavar="POLICY", help="the folder of a policy: a `cmbrl train` run")
    parser.add_argument("--onnx", metavar="FILE", help="write ONNX: float32 observations (batch, n) to actions")
    parser.add_argument("--torchscript", metavar="FILE", help="write TorchScript, for `cmbrl record --policy`")


def run(arguments: argparse.Namespace) -> None:
    files = [path for path in (arguments.onnx, arguments.torchscript) if path]
    if not files:
        raise UserError("nothing to write: give --onnx FILE, --torchscript FILE, or both")
    for path in files:
        check_writable(path)

    from cmbrl.train.policies.export import export_onnx, export_torchscript
    from cmbrl.train.policies.file import load_policy
    from cmbrl.train.running.texts import last_actions_text

    policy = load_policy(arguments.policy).policy
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
