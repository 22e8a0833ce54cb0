"""The report in a browser: it loads, every chart is there, headings sort, the console stays empty."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from cmbrl.bench.registry import STUDIES
from cmbrl.bench.report.page import PAGE, write_page
from cmbrl.bench.report.runs import run_studies
from cmbrl.bench.study import Section, Settings

from .conftest import no_bar

CHROMIUM = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), ""
)
pytestmark = pytest.mark.skipif(not CHROMIUM, reason="needs Chromium: apt-get install chromium")
# Runs at the end of a copy of the page, since --dump-dom shows what the document says, not what the browser made of it.
PROBE = """<script>
addEventListener("load", () => {
  const heads = [...document.querySelectorAll("table.sortable th")];
  const order = () => [...document.querySelectorAll("table.sortable tbody tr")].map(row => row.cells[0].innerText);
  const click = head => (head.querySelector("button").click(), order());
  document.body.innerText = "PROBE" + JSON.stringify({
    images: [...document.images].map(image => [image.alt, image.naturalWidth]),
    width: document.documentElement.scrollWidth - innerWidth,
    byError: click(heads[1]), bySolver: click(heads[0]), reversed: click(heads[0]),
  }) + "END";
});
</script></body>"""


def browse(page: Path, *options: str) -> tuple[str, str]:
    """The document as text after the page has loaded, and what the browser logged on its console."""
    done = subprocess.run(
        [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", *options, "--dump-dom",
         page.as_uri()],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    return done.stdout, "\n".join(line for line in done.stderr.splitlines() if "CONSOLE" in line)


def probe(page: Path, folder: Path, size: str) -> dict[str, Any]:
    """What the browser made of the page in a window of that size."""
    probed = folder / "probed.html"
    probed.write_text(page.read_text(encoding="utf-8").replace("</body>", PROBE), encoding="utf-8")
    document, console = browse(probed, f"--window-size={size}")
    assert console == ""
    found = re.search("PROBE(.*)END", document)
    assert found, document[-2000:]
    return json.loads(found[1])


def test_report_in_a_browser(fakes: dict[str, str], tmp_path: Path) -> None:
    run_studies(fakes, tmp_path / "out", Settings(quick=True), no_bar)
    page = write_page(tmp_path / "out")
    assert browse(page)[1] == ""
    for size in ("1280,900", "500,900"):
        seen = probe(page, tmp_path, size)
        assert [alt for alt, width in seen["images"] if width > 0] == ["Curve 0", "Curve 1", "Curve 2"]
        assert seen["width"] <= 0  # tables scroll in their box, the page does not
        assert seen["byError"] == ["b", "a", "c", "none"]
        assert seen["bySolver"] == ["a", "b", "c", "none"]
        assert seen["reversed"] == ["none", "c", "b", "a"]


@pytest.mark.skipif("CMBRL_REPORT" not in os.environ, reason="CMBRL_REPORT=DIR names the folder of a report to check")
def test_a_report_of_yours(tmp_path: Path) -> None:
    out = Path(os.environ["CMBRL_REPORT"])
    figures = [figure.title for name in STUDIES if (out / name / "section.json").exists()
               for figure in Section.read(out / name).figures]  # fmt: skip
    assert browse(out / PAGE)[1] == ""
    seen = probe(out / PAGE, tmp_path, "1280,900")
    assert [alt for alt, width in seen["images"] if width > 0] == figures
    assert seen["width"] <= 0


def test_the_console_is_listened_to(tmp_path: Path) -> None:
    page = tmp_path / "wrong.html"
    page.write_text("<!doctype html><title>x</title><script>nothing.like.it()</script>", encoding="utf-8")
    assert "nothing is not defined" in browse(page)[1]
