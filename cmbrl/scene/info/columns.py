"""Lists of words in the columns of ``cmbrl info``, and the table of a scene's parameters in it."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterable, Sequence

from cmbrl.scene.records import Parameter

_FEW = 3  # names that are listed again
_WIDTH = 98  # of the text


def counted(count: int, one: str, many: str = "") -> str:
    """``count`` with its noun, in the plural where there are several; ``many``: where that is not just an s longer."""
    return f"{count} {one if count == 1 else many or one + 's'}"


def wrapped(words: Iterable[str], indent: int = 15) -> str:
    """``words`` with commas, in lines that stand ``indent`` columns from the left."""
    lines, line = [], ""
    for word in words:
        if line and len(line) + len(word) + 3 > _WIDTH - indent:
            lines.append(line)
            line = ""
        line += (", " if line else "") + word
    return (",\n" + " " * indent).join([*lines, line])


def folded(text: str) -> list[str]:
    """The lines of ``text``, those that are too long broken between words."""
    return [
        part
        for line in text.splitlines()
        for part in textwrap.wrap(
            line, _WIDTH, subsequent_indent=" " * 15, break_long_words=False, break_on_hyphens=False
        )
        or [line]
    ]


def listed(words: Iterable[str]) -> str:
    """``words`` below their heading; nothing where there are none."""
    text = wrapped(words)
    return f"\n{' ' * 15}{text}" if text else ""


def parameter_lines(parameters: Sequence[Parameter]) -> list[str]:
    """One entry per group and nominal value, with the widest bounds in it; long lists of names are told once."""
    entries: dict[tuple[str, float, str], list[Parameter]] = {}
    groups = list(dict.fromkeys(p.group for p in parameters))
    for p in sorted(parameters, key=lambda p: groups.index(p.group)):
        entries.setdefault((p.group, p.nominal, p.unit), []).append(p)
    rows = [(("GROUP", "nominal", "bounds", "unit"), ["OF"])]
    several = Counter(group for group, _, _ in entries)
    told: dict[tuple[str, ...], str] = {}
    for (group, nominal, unit), members in entries.items():
        bounds = f"[{min(p.low for p in members):.4g}, {max(p.high for p in members):.4g}]"
        of = [p.name.removeprefix(group).removeprefix(".") or "the scene" for p in members]
        here = f"{group} at {nominal:.5g}" if several[group] > 1 else group
        rows.append(((group, f"{nominal:.5g}", bounds, "" if unit == "1" else unit), _shorter(of, here, told)))
    widths = [max(len(cells[column]) for cells, _ in rows) + 2 for column in range(4)]
    heads = ["    " + "".join(f"{c:{width}s}" for c, width in zip(cells, widths, strict=True)) for cells, _ in rows]
    return [head + wrapped(of, len(head)) for head, (_, of) in zip(heads, rows, strict=True)]


def _shorter(names: list[str], here: str, told: dict[tuple[str, ...], str]) -> list[str]:
    """Names of an entry as they are listed: parts of bodies once for all of them, many that were told by where."""
    parts: dict[str, tuple[str, ...]] = {}
    for name in names:
        body, _, part = name.partition(":")
        parts[body] = (*parts.get(body, ()), part)
    alike = next(iter(parts.values()))
    if len(parts) <= _FEW or any(each != alike for each in parts.values()):
        return names
    before = told.setdefault(tuple(parts), here)
    of = list(parts) if before == here else [f"those of {before}"]
    return [*of, f"each :{', :'.join(alike)}"] if any(alike) else of


def on_request(parameters: Sequence[Parameter]) -> list[str]:
    """Groups that a fit leaves alone unless they are named, and how to name them; none where there are none."""
    groups = dict.fromkeys(p.group for p in parameters if not p.default)
    if not groups:
        return []
    how = f"--groups {next(iter(groups))}; a fit of positions tries most of them by itself"
    return [f"    on request {wrapped(groups)}", f"{'':15}{how}"]
