"""The result of a fit: the model, its parameters with intervals, a report, and the folder that stores them."""

from __future__ import annotations

import os
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.errors import UserError
from cmbrl.files import atomic_path, check_writable, make_folder, read_record, record_text
from cmbrl.fitting.fitted_parameter import FittedParameter
from cmbrl.fitting.outcome import report_text
from cmbrl.fitting.outcome.draws import around
from cmbrl.fitting.search.objective import NOT_FINITE
from cmbrl.fitting.search.space import Space
from cmbrl.fitting.search.unseen import Unseen
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.named import RESULT, SETTINGS, load_complementarity
from cmbrl.scene.writing.fitted_file import fitted_file

MJCF, PAGE = "fitted.xml", "page.html"
_FORMAT = 3
_REMEDY = "fit again"


@dataclass(frozen=True)
class FitResult:
    """The fitted model, its parameters by name, and a report of JSON types (as text: ``report_text``).

    ``unseen``: what it was judged on; None if that was nothing, and of a fit that was read from its folder.
    """

    model: ComplementarityModel
    parameters: dict[str, FittedParameter]
    report: dict[str, Any]
    unseen: Unseen | None = None

    def save(
        self,
        folder: str | os.PathLike[str],
        task: str | None = None,
        without_play: str | os.PathLike[str] | None = None,
    ) -> Path:
        """Writes fit.json (parameters and report), model.json (scene and settings), report.txt, page.html, fitted.xml.

        fitted.xml is the scene's file with the fitted values; the report names what it cannot hold.
        ``task``: the name of the task whose scene was fitted. ``without_play``: the robot's file, where the scene is of
        one to which the fit added play. Raises UserError if the folder cannot be written, or the
        result is not finite, or the scene was not read from a file; then the files there stay as they are.
        """
        from cmbrl.fitting.outcome.page.page import page_text  # imports matplotlib: only now

        check_writable(folder, folder=True)
        scene = self.model.scene
        if not scene.path:
            raise UserError(
                f"{folder}: a saved fit names the file of its robot, and {scene.name} has none; write its XML to a file"
                " and read the scene from there"
            )
        place = make_folder(folder)
        source = {
            "path": str(Path(scene.path).resolve()),
            "ignore": list(scene.ignore),
            "contact_law": scene.contact_law,
            "self_contact": scene.self_contact,
            "reduce": scene.reduce,
            "drives": [asdict(drive) for drive in scene.drives],
        }
        parameters = {name: p.to_dict() for name, p in self.parameters.items()}
        mjcf, told = self._mjcf()
        report = {**self.report, "mjcf": told}
        text = report_text.render(self.parameters, report) + "\n"
        try:
            texts = {  # fit.json appears last: a fit is whole once it is there
                RESULT: record_text({"format": _FORMAT, "parameters": parameters, "report": report}),
                SETTINGS: record_text(
                    {
                        "scene": source,
                        "task": task,
                        "without_play": without_play and str(Path(without_play).resolve()),
                        "settings": self.model.to_config(),
                    }
                ),
                "report.txt": text,
            }
        except ValueError:
            raise UserError(f"{place}: {NOT_FINITE}") from None
        texts |= mjcf | {PAGE: page_text(replace(self, report=report))}
        with ExitStack() as together:
            for name, text in texts.items():
                together.enter_context(atomic_path(place / name)).write_text(text, encoding="utf-8")
        return place

    def _mjcf(self) -> tuple[dict[str, str], dict[str, Any]]:
        """fitted.xml by name, if MuJoCo can write it, and what the report tells of it."""
        model = self.model
        try:
            file = fitted_file(model.scene, model.parameters, model.observation)
        except UserError as error:
            return {}, {"file": None, "why": str(error)}
        return {MJCF: file.text}, {"file": MJCF, "missing": list(file.missing)}

    @classmethod
    def load(cls, folder: str | os.PathLike[str]) -> FitResult:
        """Reads what ``save`` wrote. Raises UserError that names the file if it is missing or damaged."""
        place = Path(folder)
        saved = read_record(place / RESULT, _REMEDY)
        if saved.get("format") != _FORMAT:
            raise UserError(f"{place / RESULT}: not a fit of this version; {_REMEDY}")
        try:
            parameters = {name: FittedParameter.from_dict(fields) for name, fields in saved["parameters"].items()}
            report = saved["report"]
        except (AttributeError, KeyError, TypeError):
            raise UserError(f"{place / RESULT}: damaged; {_REMEDY}") from None
        return cls(load_complementarity(place), parameters, report)

    def draws(self, count: int, seed: int = 0) -> np.ndarray:
        """Parameter sets (count, np) that explain the log about as well: normal around the fit, within the bounds.

        Parameters that the data inform vary jointly, with the covariance of the fit (``outcome.identify``), as far as
        the log bears it (``outcome.draws``).
        """
        return self._draws(count, seed)[:, : len(self.model.parameters)]

    def candidates(self, count: int, seed: int = 0) -> np.ndarray:
        """The same draws, as a model takes them: (count, np + n) with the delay, lag and biases of each.

        So is a delay that the fit has not taken and the log leaves open. (count, np) where the log informs none of
        these; then all have the fit's own.
        """
        drawn, own = self._draws(count, seed), len(self.model.parameters)
        told = {p.name for p in self.model.observer.parameters} & set(self.report["covariance"]["parameters"])
        return drawn if told else drawn[:, :own]

    def _draws(self, count: int, seed: int) -> np.ndarray:
        """(count, np + n)."""
        scene, observer = self.model.scene, self.model.observer
        nominal = np.array([self.parameters[p.name].nominal for p in scene.parameters])
        space = Space.of((*scene.parameters, *observer.parameters), np.append(nominal, observer.nominal))
        value = np.append(self.model.parameters, observer.vector(self.model.observation))
        saved = self.report["covariance"]
        told = [space.names.index(name) for name in saved["parameters"]]
        size = len(told)  # 0 where the file is right and nothing was fitted
        matrix = np.array(saved["matrix"], dtype=float).reshape(size, size) * saved.get("share", 1.0) ** 2
        delay = saved.get("delay")
        late = None if delay is None else space.names.index(delay)
        return space.theta(around(space.z(value), np.array(told, dtype=int), matrix, count, seed, late))

    def uncertain_model(self, count: int = 256, seed: int = 0) -> ComplementarityModel:
        """The fitted model with ``count`` draws as its candidates, to train policies on; without any for 0."""
        return self.model.with_settings(candidates=self.candidates(count, seed) if count else None)

    def report_text(self) -> str:
        """The report as text: what was fitted, how well, and what the data leave open."""
        return report_text.render(self.parameters, self.report)
