"""XML as MuJoCo reads it, which forgives much that the standard forbids.

Among it: dashes in comments, a bare ``&``, blank lines before the declaration, prefixes that nothing declares, bytes in
another encoding, attributes without a space between them, and whatever tags follow the root. Files that people write by
hand, or glue together, have all of these.
"""

from __future__ import annotations

import re
from bisect import bisect
from collections.abc import Iterator
from html import unescape
from xml.etree.ElementTree import Element

_TAG = re.compile(r"""<(?P<end>/)?\s*(?P<name>[^\s<>/"'=]+)(?P<attributes>(?:[^<>"']++|"[^"]*+"|'[^']*+')*+)>""")
_ATTRIBUTE = re.compile(r"""([^\s=/"']+)\s*=\s*(?:"([^"]*)"|'([^']*)')""")
_OTHERS = (("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>"), ("<!", ">"))


def elements(data: bytes | str) -> Iterator[tuple[str, Element]]:
    """("start", element) and ("end", element) of the root and all in it, without their text or children.

    Raises ValueError with a line's number where a tag is broken, closes another element, or is missing.
    """
    text = data if isinstance(data, str) else data.decode("utf-8-sig", errors="replace")
    text = text.partition("\0")[0]
    lines = [match.start() for match in re.finditer("\n", text)]
    above: list[Element] = []
    for at, tag in _tags(text, lines):
        name = tag["name"]
        if tag["end"]:
            if not above or above[-1].tag != name:
                inside = f", which does not close <{above[-1].tag}>" if above else ""
                raise ValueError(f"line {_line(lines, at)}: </{name}>{inside}")
            yield "end", above.pop()
        else:
            found = _ATTRIBUTE.findall(tag["attributes"])
            element = Element(name, {key: unescape(double or single) for key, double, single in found})
            yield "start", element
            if tag["attributes"].endswith("/"):
                yield "end", element
            else:
                above.append(element)
        if not above:
            return
    raise ValueError(f"<{above[-1].tag}> is not closed" if above else "it has no element")


def tree(data: bytes | str) -> Element:
    """The root of all elements, without their text; raises ValueError as ``elements`` does."""
    above: list[Element] = []
    for event, element in elements(data):
        if event == "start":
            if above:
                above[-1].append(element)
            above.append(element)
        else:
            root = above.pop()
    return root


def _tags(text: str, lines: list[int]) -> Iterator[tuple[int, re.Match[str]]]:
    """Where each tag starts, and what is in it."""
    at = text.find("<")
    while at >= 0:
        end = next((end for start, end in _OTHERS if text.startswith(start, at)), None)
        if end is not None:
            close = text.find(end, at)
            if close < 0:
                raise ValueError(f"line {_line(lines, at)}: {end} is missing")
            at = text.find("<", close + len(end))
            continue
        tag = _TAG.match(text, at)
        if tag is None:
            raise ValueError(f"line {_line(lines, at)}: a tag that is not closed, or a quote")
        yield at, tag
        at = text.find("<", tag.end())


def _line(lines: list[int], at: int) -> int:
    return bisect(lines, at) + 1
