"""What a fit returns: the model, each parameter with its interval, a report; and the folder that keeps them."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.errors import UserError
from cmbrl.files import check_writable, read_json, write_json, write_text
from cmbrl.fit.space import Space
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.named import SETTINGS, load_complementarity

_FORMAT = 1
_NONE = "  none: the nominal model explains the held-out episodes as well as any other"
FITTED, AT_BOUND, FLAT, GAUGE, NOMINAL = "fitted", "at bound", "flat", "gauge", "nominal"


@dataclass(frozen=True)
class FittedParameter:
    """A parameter after the fit, in its own unit; ``low`` and ``high`` bound its 95 % interval.

    ``status``: "fitted"; "at bound"; "flat" (fitted, but the data hardly tell it: it stayed near its prior); "gauge"
    (a mass held because motion does not tell the unit of force); "nominal" (not fitted: held-out error did not ask
    for it, or not chosen).
    """

    value: float
    low: float
    high: float
    nominal: float
    status: str
    unit: str = ""


@dataclass(frozen=True)
class FitResult:
    """``model``: the fitted model; ``parameters``: by name; ``report``: JSON-able, see ``report_text``."""

    model: Any
    parameters: dict[str, FittedParameter]
    report: dict[str, Any]

    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Writes fit.json (parameters and report), model.json (scene and settings) and report.txt.

        Raises UserError when the folder cannot be written.
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
        """Reads what ``save`` wrote. Raises UserError that names the file when it is missing or not a saved fit."""
        place = Path(folder)
        saved = read_json(place / "fit.json")
        if not isinstance(saved, dict) or saved.get("format") != _FORMAT:
            raise UserError(f"{place / 'fit.json'}: not a fit of this version: fit again")
        try:
            parameters = {name: FittedParameter(**fields) for name, fields in saved["parameters"].items()}
            report = saved["report"]
        except (AttributeError, KeyError, TypeError):
            raise UserError(f"{place / 'fit.json'}: damaged: fit again") from None
        return cls(_load_model(place / SETTINGS, parameters), parameters, report)

    def draws(self, count: int, seed: int = 0) -> np.ndarray:
        """Parameter sets (count, np) that explain the log about as well: normal around the fit, within the bounds.

        Only parameters that the data tell vary; together, as the covariance of the fit says (see
        ``cmbrl.fit.identify``).
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
        """The fitted model with ``count`` draws beside it as its candidates: what policies are trained on."""
        return self.model.with_settings(candidates=self.draws(count, seed))

    def report_text(self) -> str:
        """The report for people: what was fitted, how well, and what the data leave open."""
        return "\n".join(_lines(self.parameters, self.report))


def _load_model(file: Path, parameters: dict[str, FittedParameter]) -> ComplementarityModel:
    model = load_complementarity(file)
    if {p.name for p in model.scene.parameters} != set(parameters):
        raise UserError(f"{file}: its scene has other parameters than when it was fitted: fit again")
    return model


def _lines(parameters: dict[str, FittedParameter], report: dict[str, Any]) -> list[str]:
    data, losses = report["data"], report["loss"]
    lines = [
        f"fit of {data['transitions']} transitions in {data['episodes']} episodes by {report['method']}, "
        f"seed {report['seed']}, {report['seconds']['total']:.1f} s, {report['candidates']} candidates",
        f"error over {report['horizon']} step(s): RMSE (1 = the standard deviation of the change) and Huber loss",
        f"  {'':<36}{'RMSE':>10}{'loss':>12}{'failed':>8}",
    ]
    lines += [
        f"  {stage:<36}{row['rmse']:>10.4f}{row['loss']:>12.4g}{row['failures']:>8d}" for stage, row in losses.items()
    ]
    if report["stopped"] is not None:
        lines.append(f"STOPPED EARLY ({report['stopped']}): best so far")
    if report["selection"] is not None:
        lines.append("groups selected by the fall of the held-out loss (its noise: standard error over episodes):")
        lines += [
            f"  {s['move']:<7}{s['group']:<20} {s['gain']:.4g} (noise {s['noise']:.2g}), RMSE {s['held_out_rmse']:.4f}"
            for s in report["selection"]
        ] or [_NONE if report["stopped"] is None else "  none so far"]
    moved = {n: p for n, p in parameters.items() if p.status != NOMINAL}
    if moved:
        lines.append(f"  {'parameter':<36}{'value':>12}{'95 % interval':>28}{'nominal':>12}  status")
        for name, p in moved.items():
            interval = f"[{p.low:.5g}, {p.high:.5g}]"
            lines.append(f"  {name:<36}{p.value:>12.5g}{interval:>28}{p.nominal:>12.5g}  {p.status} {p.unit}".rstrip())
    if report["flat_directions"]:
        lines.append("flat directions (the data tell less than the prior did):")
        for d in report["flat_directions"]:
            lines.append("  " + " ".join(f"{c:+.2f} {name}" for name, c in d["parameters"].items()))
    for key, text in (
        ("at_bound", "on a bound"),
        ("unseen", "not fitted, and this log would not tell them"),
        ("gauge", "held, since motion does not tell the unit of force"),
    ):
        if report[key]:
            lines.append(f"{text}: {', '.join(report[key])}")
    for element in report["left_out"]:
        lines.append(f"left out of the scene: {element['kind']} {element['name']} ({element['why']})")
    return lines
