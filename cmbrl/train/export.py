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
from importlib.util import find_spec
from io import StringIO

import torch

from cmbrl.errors import UserError
from cmbrl.files import atomic_path
from cmbrl.train.policy import Policy

INPUT, OUTPUT = "observation", "action"


def export_torchscript(policy: Policy, path: str | os.PathLike[str]) -> None:
    """Writes a TorchScript module; raises UserError if ``path`` cannot be written."""
    with atomic_path(path) as temporary, _quietly():
        traced = torch.jit.trace(policy.eval(), _example(policy))
        torch.jit.freeze(traced).save(str(temporary))  # type: ignore[no-untyped-call]


def export_onnx(policy: Policy, path: str | os.PathLike[str]) -> None:
    """Writes one ONNX file with input "observation", output "action" and any batch size.

    Raises UserError if ``path`` cannot be written or an exporter is not installed.
    """
    for package in ("onnx", "onnxscript"):
        if find_spec(package) is None:
            raise UserError(f"writing ONNX needs {package}: pip install 'cmbrl[export]'")
    with atomic_path(path) as temporary, _quietly():
        torch.onnx.export(
            policy.eval(),
            (_example(policy),),
            str(temporary),
            input_names=[INPUT],
            output_names=[OUTPUT],
            dynamic_shapes=({0: torch.export.Dim("batch")},),
            external_data=False,
            dynamo=True,
            verbose=False,
        )


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
