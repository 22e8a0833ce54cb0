"""Tables fit a terminal: wide ones continue below with their row names, long texts are wrapped, nothing is lost."""

from __future__ import annotations

import random

from cmbrl.table import Table


def test_wide_tables_continue_below() -> None:
    draw = random.Random(0)
    columns = ["scene", "simulator", *(f"column {k}" for k in range(20))]
    rows = [[f"scene {i}", f"simulator {i}", *(draw.random() * 10.0**k for k in range(20))] for i in range(3)]
    text = Table("Title", columns, rows, "A note. " * 30).text()
    assert max(map(len, text.splitlines())) <= 100
    for row in rows:
        assert text.count(str(row[0])) == text.count("scene  ")  # named in every block
        assert all(f"{x:.4g}" in text for x in row[2:])
    assert all(name in text for name in columns)


def test_long_texts_are_wrapped_in_their_column() -> None:
    words = " ".join(f"word{k}" for k in range(60))
    text = Table("Title", ["scene", "h", "what it shows"], [["F1", 0.001, words], ["F2", 0.5, "short"]]).text()
    assert max(map(len, text.splitlines())) <= 100
    assert all(f"word{k}" in text for k in range(60))
    lines = text.splitlines()
    start = lines[1].index("what")
    inside = lines[2 : next(i for i, line in enumerate(lines) if line.startswith("F2"))]
    assert all(not line[:start].strip() for line in inside[1:])


def test_a_name_wider_than_the_terminal() -> None:
    text = Table("T", ["name", "x"], [["n" * 150, 1.0]]).text()
    assert "n" * 150 in text
