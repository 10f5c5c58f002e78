"""The report is one page that needs nothing but itself."""

from __future__ import annotations

import base64
import io
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from matplotlib.image import imread
from results_cases import grid, sweep, tuned
from study_cases import CRITERIA, TEXT

from imm_tdoa.study import parse, report, results, run
from imm_tdoa.study.report import conclusions, page

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
VOID = {"meta", "link", "img", "br", "hr"}


class Page(HTMLParser):
    """What is on a page; refuses elements that are not closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.texts: dict[str, list[str]] = {}
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {key: value or "" for key, value in attrs}))
        if tag not in VOID:
            self.open.append(tag)
            self.texts.setdefault(tag, []).append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        for tag in set(self.open):
            self.texts[tag][-1] += data

    def all(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.elements if name == tag]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str], xr.Dataset]:
    folder = tmp_path_factory.mktemp("report")
    given, shelf = sweep(runs=30)
    data = results.collect(given, shelf).isel(scenario=[0, 2])
    return folder, report.write(data, given, folder), data


@pytest.fixture(scope="module")
def html(written: tuple[Path, list[str], xr.Dataset]) -> str:
    return (written[0] / "report.html").read_text("utf-8")


def test_every_picture_is_in_the_page_and_beside_it(
    written: tuple[Path, list[str], xr.Dataset], html: str
) -> None:
    folder, names, _ = written
    images = Page(html).all("img")
    assert len(images) == len(names) - 1 == 2 + 2 * 3
    for image, name in zip(images, names[1:], strict=True):
        kind, _, data = image["src"].partition(",")
        assert kind == "data:image/png;base64"
        png = base64.b64decode(data, validate=True)
        assert png == (folder / name).read_bytes()
        pixels = imread(io.BytesIO(png), format="png")
        assert [str(n) for n in pixels.shape[1::-1]] == [image["width"], image["height"]]
        assert len(image["alt"]) > 30


def test_nothing_comes_from_elsewhere(html: str) -> None:
    found = Page(html)
    tags = {tag for tag, _ in found.elements}
    assert not tags & {"script", "iframe", "object", "embed", "base", "form"}
    for tag, attributes in found.elements:
        for key, value in attributes.items():
            assert not key.startswith("on")
            if key in ("src", "href", "srcset", "action", "data"):
                assert value.startswith(("#", "data:")), (tag, key, value[:50])
    style = "".join(found.texts["style"])
    assert "url(" not in style
    assert "@import" not in style


def test_every_link_leads_somewhere(html: str) -> None:
    found = Page(html)
    ids = [attributes["id"] for _, attributes in found.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    links = [a["href"] for a in found.all("a")]
    assert len(links) == 2 * 2 + 3
    assert {link[1:] for link in links} <= set(ids)


def test_it_says_what_there_is_to_conclude(
    written: tuple[Path, list[str], xr.Dataset], html: str
) -> None:
    data = written[2]
    items = [text.replace("\u00a0", " ") for text in Page(html).texts["li"]]
    for sentences in conclusions.conclude(data).values():
        assert set(sentences) <= set(items)


def test_words_of_the_user_are_text(html: str) -> None:
    found = Page(html)
    assert found.texts["title"] == ["A <small> study"]
    assert found.texts["h1"] == ["A <small> study"]
    assert "small" not in [attributes.get("class") for _, attributes in found.elements]
    assert "Made of random numbers & nothing else." in found.texts["p"]
    assert 'title = "A <small> study"\n' in found.texts["code"]
    assert "viewport" in [meta.get("name") for meta in found.all("meta")]
    assert found.all("html")[0]["lang"] == "en"


def test_tables_hold_the_figures(written: tuple[Path, list[str], xr.Dataset], html: str) -> None:
    data = written[2]
    cells = Page(html).texts["td"]
    for i in range(2):
        for b in range(3):
            letters = str(data["letters"].values[i, b])
            value = float(data["position_rmse"].values[i, b])
            assert any(re.fullmatch(rf"{value:.1f}\d? m{letters}", cell) for cell in cells)


def test_many_banks_go_down_the_page(tmp_path: Path) -> None:
    """Seven banks and more in fewer scenarios: a row each; their figures stay with them."""
    given, shelf = tuned(runs=12)
    data = results.collect(given, shelf)
    report.write(data, given, tmp_path)
    found = Page((tmp_path / "report.html").read_text("utf-8"))
    cells, heads = found.texts["td"], found.texts["th"]
    assert heads[:3] == ["bank", "one", "two"]
    for b, name in enumerate(data["bank"].values):
        row = cells[3 * b : 3 * b + 3]
        assert row[0] == name
        for cell, value in zip(row[1:], data["position_rmse"].values[:, b], strict=True):
            assert cell.startswith(f"{value:.1f}")


def test_escaping() -> None:
    node = page.element("p", "a < b & ", page.element("b", "<i>"), " c > d", class_='x"y')
    text = page.write("t", node)
    assert '<p class="x&quot;y">a &lt; b &amp; <b>&lt;i&gt;</b> c &gt; d</p>' in text


def test_two_parameters_make_a_map(tmp_path: Path) -> None:
    given, shelf = grid(runs=12)
    data = results.collect(given, shelf).isel(scenario=[0, 1, 8, 9])
    names = report.write(data, given, tmp_path)
    assert "pictures/winners-grid.png" in names
    assert len(Page((tmp_path / "report.html").read_text("utf-8")).all("img")) == 1 + 4 * 2


def test_a_real_study_from_its_file_to_its_report(tmp_path: Path) -> None:
    """Two scenarios of 20 runs, three banks and a criterion, through every stage."""
    given = parse(TEXT + CRITERIA)
    store = run(given, tmp_path, workers=1)
    data = results.collect(given, store)
    assert data["position_rmse"].shape == (2, 3)
    assert np.isfinite(data["position_rmse"]).all()
    assert data["place"].sel(bank="static").values.tolist() == [3, 3]  # it drives, at first
    assert data["candidate_name"].values.tolist() == [["static", "CV"]]
    evidence = data["run_log_likelihood"]
    ahead = evidence.sel(bank="CV") > evidence.sel(bank="static")
    np.testing.assert_allclose(data["chosen"].values[:, 0, 1], ahead.mean("run"))
    np.testing.assert_allclose(data["bound_ratio"].sel(bank="IMM"), 1.0, atol=0.6)
    files = [*results.write(data, given, store, tmp_path), *report.write(data, given, tmp_path)]
    assert all((tmp_path / name).is_file() for name in files)
    assert {"pictures/sweep-drive.png", "pictures/criteria-drive.png"} <= set(files)
    found = Page((tmp_path / "report.html").read_text("utf-8"))
    assert found.texts["code"] == [given.text]
    assert len(found.all("img")) == 2 + 2 * 3


HARNESS = """<!DOCTYPE html><meta charset="utf-8"><title>harness</title>
<body style="margin:0"><script>
const html = {html}, widths = [360, 1280], found = [];
for (const width of widths) {{
  const frame = document.createElement("iframe");
  frame.style = "border:0;height:900px;width:" + width + "px";
  frame.onload = () => setTimeout(() => {{
    const page = frame.contentDocument, root = page.documentElement;
    const images = [...page.images];
    const box = e => e.getBoundingClientRect();
    const outside = [...page.querySelectorAll("body *")].filter(e =>
      !e.closest(".scroll, pre") && box(e).right > width + 1).map(e => e.tagName);
    const bright = e => frame.contentWindow.getComputedStyle(e);
    found.push({{
      width, scroll: root.scrollWidth, client: root.clientWidth, outside,
      images: images.length,
      whole: images.filter(i => i.complete && i.naturalWidth > 300).length,
      shown: Math.min(...images.map(i => box(i).width)),
      widest: Math.max(...images.map(i => box(i).width)),
      text: Math.min(...[...page.querySelectorAll("p, li, td")].map(
        e => parseFloat(bright(e).fontSize))),
      ink: bright(page.body).color, paper: bright(page.body).backgroundColor,
      loaded: frame.contentWindow.performance.getEntriesByType("resource")
        .map(e => e.name.slice(0, 10)).filter(n => !n.startsWith("data:")),
    }});
    if (found.length === widths.length) {{
      const out = document.createElement("pre");
      out.id = "found";
      out.textContent = JSON.stringify(found);
      document.body.append(out);
    }}
  }}, 300);
  frame.srcdoc = html;
  document.body.append(frame);
}}
</script></body>"""


def browser() -> str:
    for name in BROWSERS:
        path = shutil.which(name)
        if path is not None:
            return path
    pytest.skip("no Chromium or Chrome on this machine")


def show(path: str, profile: Path, address: Path, *options: str) -> tuple[str, str]:
    done = subprocess.run(
        [
            path,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--enable-logging=stderr",
            "--virtual-time-budget=20000",
            f"--user-data-dir={profile}",
            *options,
            "--dump-dom",
            address.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    return done.stdout, done.stderr


def test_a_browser_shows_it_on_a_telephone_and_on_a_desk(
    written: tuple[Path, list[str], xr.Dataset], html: str, tmp_path: Path
) -> None:
    """No message on the console, every picture there, nothing wider than the screen."""
    path = browser()
    _, log = show(path, tmp_path / "profile", written[0] / "report.html")
    assert "CONSOLE" not in log
    harness = tmp_path / "harness.html"
    embedded = json.dumps(html).replace("</", "<\\/")
    harness.write_text(HARNESS.format(html=embedded), encoding="utf-8")
    dom, log = show(path, tmp_path / "profile", harness, "--window-size=1700,1000")
    assert "CONSOLE" not in log
    match = re.search(r'<pre id="found">(.*?)</pre>', dom, re.S)
    assert match is not None
    screens: list[dict[str, Any]] = json.loads(match[1])
    assert sorted(screen["width"] for screen in screens) == [360, 1280]
    for screen in screens:
        assert screen["scroll"] <= screen["client"] <= screen["width"]
        assert screen["outside"] == []
        assert screen["images"] == screen["whole"] == len(written[1]) - 1
        assert screen["shown"] >= 0.85 * min(screen["width"], 700)
        assert screen["widest"] <= screen["width"]
        assert screen["text"] >= 14.0
        assert screen["loaded"] == []
        ink, paper = (np.array(re.findall(r"\d+", screen[k])[:3], int) for k in ("ink", "paper"))
        assert paper.min() - ink.max() > 150
