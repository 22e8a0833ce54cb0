"""What an MJCF or a URDF asks of its compiler, checked before MuJoCo reads it: files and counts that have an end.

MuJoCo opens whatever a file names, and makes as many copies as a file asks for; neither can be interrupted.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from xml.etree.ElementTree import Element

from cmbrl.errors import UserError
from cmbrl.reading import regular_file
from cmbrl.scene.source import markup
from cmbrl.text import shortened

ELEMENTS = 10_000  #: at most, with every copy counted; MuJoCo takes seconds for that many bodies
FREEDOM = 8_000  #: degrees of freedom, of joints with every copy; MuJoCo's memory is 44 bytes times their square
DEPTH = 500  #: of nested elements, as in MuJoCo
AMOUNT = 100_000  #: largest value of an attribute that is a number of array entries
USER_DATA = 10_000_000  #: of nuserdata, of which there are files that reserve more than others

_ROOTS = ("mujoco", "robot")  # of an MJCF, of a URDF
_COPIES = ("replicate", "composite", "flexcomp")  # their `count` (one number or several) multiplies what is inside
_AMOUNTS = ("size", "nsample", "nrow", "ncol", "width", "height", "nuserdata", "nkey", "subdivision", "maxhullvert")
_FREEDOMS = {"free": 6, "floating": 6, "ball": 3, "planar": 3, "fixed": 0}  # of joints by type; of others 1
_FOLDERS = ("meshdir", "texturedir", "assetdir")


@dataclass
class _Reader:
    main: Path
    folders: set[Path] = field(default_factory=set)
    freedom: int = 0  # degrees of freedom so far
    root: str = ""  # tag of the main file's root element
    models: dict[str, int] = field(default_factory=dict)  # name of a <model> asset -> its number of elements

    def elements(self, file: Path, above: tuple[Path, ...] = (), text: str | None = None) -> int:
        """Number of elements of ``file`` (or of its ``text``), copies and included files counted.

        Raises UserError beyond a limit.
        """
        total, copies = 0, [1]
        for event, element in markup.elements(text if text is not None else file.read_bytes()):
            if event == "end":
                copies.pop()
                continue
            if not above and len(copies) == 1 and element.tag not in _ROOTS:
                raise UserError(
                    f"{self.main}: not an MJCF: the root element is <{element.tag[:40]}>, expected <mujoco> or, of a "
                    "URDF, <robot>"
                )
            self.root = self.root or element.tag
            self._check_amounts(element)
            total += copies[-1] * (1 + self._named(element, file, above))
            self.freedom += copies[-1] * _freedom(element)
            copies.append(copies[-1] * _copies(element))
            if len(copies) > DEPTH:
                raise UserError(f"{file}: elements are nested more than {DEPTH} deep")
            if self.freedom > FREEDOM:
                raise UserError(
                    f"{self.main}: more than {FREEDOM} degrees of freedom, counting every copy of a joint, and MuJoCo "
                    "needs memory by their square: ask for fewer bodies"
                )
            if max(total, copies[-1]) > ELEMENTS:
                raise UserError(
                    f"{self.main}: more than {ELEMENTS} elements, counting every copy of <{element.tag}>: ask for fewer"
                )
        return total

    def _named(self, element: Element, file: Path, above: tuple[Path, ...]) -> int:
        """Elements in the file that an element brings in; every file that it names must have an end."""
        if element.tag == "compiler":
            self.folders |= {self.main.parent / element.attrib[key] for key in _FOLDERS if key in element.attrib}
        if element.tag == "attach":
            return self.models.get(element.get("model", ""), 0)
        found = [path for name in _files(element) for path in self._places(name, file)]
        for path in found:
            regular_file(path, f"named in {file}")
        if element.tag not in ("include", "model") or not found or found[0] in above:
            return 0
        if len(above) > DEPTH:
            raise UserError(f"{self.main}: files include each other more than {DEPTH} deep")
        inside = self.elements(found[0], (*above, file))
        if element.tag == "model":
            self.models[element.get("name", found[0].stem)] = inside
        return inside

    def _places(self, name: str, file: Path) -> list[Path]:
        """Where the file ``name`` may lie, as far as something is there; a missing one is for MuJoCo to report.

        MuJoCo looks for what a URDF names without its folders.
        """
        folders, names = (self.main.parent, file.parent, *self.folders), dict.fromkeys((name, name.rsplit("/", 1)[-1]))
        places = [folder / each for folder in folders for each in names if each]
        return [path for path in places if os.path.lexists(path) and os.path.exists(path)]

    def _check_amounts(self, element: Element) -> None:
        for key, text in element.attrib.items():
            sizes = key.startswith("nuser_") or (key in _AMOUNTS and (key != "size" or element.tag == "numeric"))
            most = USER_DATA if key == "nuserdata" else AMOUNT
            if sizes and prod(_whole(text)) > most:
                raise UserError(f"{self.main}: <{element.tag}> asks for {key}={shortened(text)!r}, more than {most}")


def check_xml(source: Path | str) -> str:
    """The tag of the root element, "mujoco" or "robot".

    Raises UserError unless a file or a text is XML of an MJCF or a URDF that names files and counts with an end.
    """
    path, text = (source, None) if isinstance(source, Path) else (Path("XML text"), source)
    reader = _Reader(path)
    try:
        reader.elements(path, text=text)
    except UserError:
        raise
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); check its permissions") from None
    except ValueError as error:
        raise UserError(f"{path}: not an MJCF: invalid XML ({shortened(str(error), 200)})") from None
    return reader.root


def _freedom(element: Element) -> int:
    """Degrees of freedom of a joint; 0 of other elements, and of the joints that tendons and equalities name."""
    if element.tag == "freejoint":
        return 6
    named = element.tag != "joint" or element.attrib.keys() & {"joint", "joint1"}
    return 0 if named else _FREEDOMS.get(element.get("type", ""), 1)


def _copies(element: Element) -> int:
    return prod(max(n, 1) for n in _whole(element.get("count", ""))) if element.tag in _COPIES else 1


def _files(element: Element) -> Iterator[str]:
    return (text for key, text in element.attrib.items() if key.startswith("file") and "\0" not in text)


def _whole(text: str) -> list[int]:
    """The whole numbers in ``text``; what is none is for MuJoCo to report."""
    found = []
    for word in text.split()[:10]:
        try:
            found.append(int(min(abs(float(word)), 1e18)))
        except ValueError:  # also NaN
            continue
    return found
