"""The result of a fit: the model, its parameters with intervals, a report, and the folder that stores them."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.errors import UserError
from cmbrl.files import check_writable, read_json, write_json, write_text
from cmbrl.fitting import report_text
from cmbrl.fitting.fitted_parameter import FittedParameter
from cmbrl.fitting.space import Space
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.named import SETTINGS, load_complementarity

_FORMAT = 1


@dataclass(frozen=True)
class FitResult:
    """The fitted model, its parameters by name, and a report of JSON types (as text: ``report_text``)."""

    model: ComplementarityModel
    parameters: dict[str, FittedParameter]
    report: dict[str, Any]

    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Writes fit.json (parameters and report), model.json (scene and settings) and report.txt.

        Raises UserError if the folder cannot be written.
        """
        place = Path(folder)
        check_writable(place, folder=True)
        place.mkdir(parents=True, exist_ok=True)
        scene = self.model.scene
        source = {
            "path": str(Path(scene.path).resolve()),
            "ignore": list(scene.ignore),
            "contact_law": scene.contact_law,
            "reduce": scene.reduce,
        }
        write_json(place / SETTINGS, {"scene": source, "settings": self.model.to_config()})
        write_text(place / "report.txt", self.report_text() + "\n")
        write_json(
            place / "fit.json",
            {
                "format": _FORMAT,
                "parameters": {name: asdict(p) for name, p in self.parameters.items()},
                "report": self.report,
            },
        )
        return place

    @classmethod
    def load(cls, folder: str | os.PathLike[str]) -> FitResult:
        """Reads what ``save`` wrote. Raises UserError that names the file if it is missing or damaged."""
        place = Path(folder)
        saved = read_json(place / "fit.json")
        if not isinstance(saved, dict) or saved.get("format") != _FORMAT:
            raise UserError(f"{place / 'fit.json'}: not a fit of this version; fit again")
        try:
            parameters = {name: FittedParameter(**fields) for name, fields in saved["parameters"].items()}
            report = saved["report"]
        except (AttributeError, KeyError, TypeError):
            raise UserError(f"{place / 'fit.json'}: damaged; fit again") from None
        return cls(_load_model(place / SETTINGS, parameters), parameters, report)

    def draws(self, count: int, seed: int = 0) -> np.ndarray:
        """Parameter sets (count, np) that explain the log about as well: normal around the fit, within the bounds.

        Parameters that the data inform vary jointly, with the covariance of the fit (``cmbrl.fitting.identify``).
        """
        scene = self.model.scene
        nominal = np.array([self.parameters[p.name].nominal for p in scene.parameters])
        space = Space.of(scene.parameters, nominal)
        saved = self.report["covariance"]
        told = [space.names.index(name) for name in saved["parameters"]]
        z = np.tile(space.z(self.model.parameters), (count, 1))
        if told:
            values, vectors = np.linalg.eigh(np.array(saved["matrix"]))
            root = vectors * np.sqrt(np.maximum(values, 0.0))
            z[:, told] += np.random.default_rng(seed).normal(size=(count, len(told))) @ root.T
        return space.theta(z)

    def uncertain_model(self, count: int = 256, seed: int = 0) -> ComplementarityModel:
        """The fitted model with ``count`` draws as its candidates, to train policies on."""
        return self.model.with_settings(candidates=self.draws(count, seed))

    def report_text(self) -> str:
        """The report as text: what was fitted, how well, and what the data leave open."""
        return report_text.render(self.parameters, self.report)


def _load_model(file: Path, parameters: dict[str, FittedParameter]) -> ComplementarityModel:
    model = load_complementarity(file)
    if {p.name for p in model.scene.parameters} != set(parameters):
        raise UserError(f"{file}: the scene's parameters have changed since the fit; fit again")
    return model
