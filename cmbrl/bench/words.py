"""The prose of a study, in ``text.toml`` next to its code: title, method, captions of figures, notes of tables."""

from __future__ import annotations

import tomllib
from importlib.resources import files
from typing import Any

from cmbrl.bench.study import Figure


class Words:
    """``Words("cmbrl.bench.studies.throws")`` reads that folder's ``text.toml``.

    A value is a paragraph or several (a blank line between them); ``{name}`` in it is filled in by ``str.format``.
    Figures stand in tables ``[figures."FILE.png"]`` with ``title`` and ``caption``.
    """

    def __init__(self, package: str) -> None:
        self._values: dict[str, Any] = tomllib.loads(files(package).joinpath("text.toml").read_text(encoding="utf-8"))

    def __call__(self, name: str, **values: Any) -> str:
        """The text called ``name`` ("method", "tables.runs"), lines joined to paragraphs; KeyError if there is none."""
        found: Any = self._values
        for part in name.split("."):
            found = found[part]
        paragraphs = (" ".join(paragraph.split()) for paragraph in found.strip().split("\n\n"))
        text = "\n\n".join(paragraphs)
        return text.format(**values) if values else text

    def figure(self, file: str, **values: Any) -> Figure:
        """The picture ``file`` with its title and caption."""
        about = self._values["figures"][file]
        caption = " ".join(about["caption"].split())
        return Figure(file, about["title"].format(**values), caption.format(**values) if values else caption)

    def figures(self) -> list[Figure]:
        """All pictures, in the order of the file."""
        return [self.figure(file) for file in self._values["figures"]]
