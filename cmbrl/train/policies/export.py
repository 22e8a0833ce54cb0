"""A policy for other programs: ONNX and TorchScript, both including the observation scaling.

Both map float32 observations (batch, n_o) to deterministic actions (batch, n_a) in [-1, 1]. ``cmbrl record --behaviour
policy --policy FILE`` takes the TorchScript file.
"""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from copy import deepcopy
from importlib.util import find_spec
from io import BytesIO, StringIO

import torch
from torch import nn

from cmbrl.data.behaviour import LAST_ACTIONS
from cmbrl.errors import UserError
from cmbrl.files import write_bytes
from cmbrl.train.policies.policy import Policy

INPUT, OUTPUT = "observation", "action"


def export_torchscript(policy: Policy, path: str | os.PathLike[str]) -> None:
    """Writes a TorchScript module; raises UserError if ``path`` cannot be written."""
    content = BytesIO()
    with _quietly():
        traced = torch.jit.trace(_traceable(policy), _example(policy))
        told = {LAST_ACTIONS: str(policy.architecture.last_actions)}
        torch.jit.save(torch.jit.freeze(traced), content, told)  # type: ignore[no-untyped-call]
    write_bytes(path, content.getvalue())


def export_onnx(policy: Policy, path: str | os.PathLike[str]) -> None:
    """Writes one ONNX file with input "observation", output "action" and any batch size.

    Raises UserError if ``path`` cannot be written or an exporter is not installed.
    """
    for package in ("onnx", "onnxscript"):
        if find_spec(package) is None:
            raise UserError(f"writing ONNX needs {package}: pip install 'cmbrl[export]'")
    with _quietly():
        program = torch.onnx.export(
            _traceable(policy),
            (_example(policy),),
            input_names=[INPUT],
            output_names=[OUTPUT],
            dynamic_shapes=({0: torch.export.Dim("batch")},),
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    write_bytes(path, program.model_proto.SerializeToString())


def _traceable(policy: Policy) -> Policy:
    """A copy whose net has torch's operations."""
    found = deepcopy(policy).eval()
    found.net = nn.Sequential(*found.net)
    return found


def _example(policy: Policy) -> torch.Tensor:
    return torch.zeros(2, policy.architecture.observations)


@contextmanager
def _quietly() -> Iterator[None]:
    """Silences what the exporters print and log about their future versions and about packages that no policy needs."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    with warnings.catch_warnings(), redirect_stdout(StringIO()):
        warnings.simplefilter("ignore")
        logger.setLevel(logging.ERROR)
        try:
            yield
        finally:
            logger.setLevel(level)
