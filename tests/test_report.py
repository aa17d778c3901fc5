"""The pages of a report: they need nothing else, and every number leads to a row."""

import re
import tomllib
from fnmatch import fnmatch
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from sweeps import make_sweep, plausible_sweep

from swe_sphere.cli.sweep import PAGE, REPORT
from swe_sphere.errors import ConfigError
from swe_sphere.studies import words
from swe_sphere.studies.pages import MARK
from swe_sphere.studies.report import sweep_rankings, write_report
from swe_sphere.studies.report.figures import error_pictures
from swe_sphere.studies.report.page import read_sections
from swe_sphere.studies.report.ranking import metrics, read_runs
from swe_sphere.studies.sweep.sweep_plan import Recipe

ROOT = Path(__file__).parents[1]
SMALL = dict.fromkeys(("mass_drift", "energy_drift", "enstrophy_drift"), np.nan)
"""A run of which few diagrams can be drawn."""
VOID = {"meta", "input", "link", "br", "img", "hr"}


class Page(HTMLParser):
    """Elements of a page; raises where one is not closed."""

    def __init__(self, text):
        super().__init__()
        self.ids, self.links, self.loads, self.tables, self.open = [], [], [], 0, []
        self.cells = {}
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.ids += [given["id"]] if "id" in given else []
        self.links += [given["href"]] if "href" in given else []
        self.loads += [value for name, value in attributes if name in ("src", "srcset", "data")]
        if tag not in VOID:
            self.open.append(tag)
        if tag == "tr":
            self.row = self.cells.setdefault(given.get("id"), [])

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "td":
            self.row.append(data)


@pytest.fixture(scope="module")
def dataset():
    whole = plausible_sweep()
    keep = ((whole.kind == "total") & (whole.field == "h")) | (
        (whole.kind == "slow") & (whole.field == "vorticity")
    )
    whole["error"] = whole.error.where(keep)
    whole["newton_iterations"][:] = 0.0
    return whole


@pytest.fixture(scope="module")
def folder(dataset, tmp_path_factory):
    return write_report(dataset, tmp_path_factory.mktemp("report") / "new" / "folder").parent


@pytest.fixture(scope="module")
def text(folder):
    return (folder / "index.html").read_text(encoding="utf-8")


def test_the_page_is_well_formed_and_loads_nothing(text):
    page = Page(text)
    assert len(page.loads) > 5
    assert all(load.startswith("data:image/svg+xml;base64,") for load in page.loads)
    assert not re.search(r"https?:|@import|url\(", text)
    assert text.count("<style") == 1  # those of figures would hold for the whole page


def test_every_link_of_the_page_leads_somewhere_in_it(text):
    page = Page(text)
    assert len(page.ids) == len(set(page.ids))
    assert {link.removeprefix("#") for link in page.links} <= set(page.ids)


def test_every_row_is_in_the_table_with_its_fate(dataset, text):
    cells = Page(text).cells
    for number in range(1, dataset.sizes["run"] + 1):
        assert cells[f"williamson5-{number}"][0] == str(number)
        run = dataset.isel(run=number - 1)
        ended = str(run.status.item())
        assert any(cell.startswith(ended) for cell in cells[f"williamson5-{number}"])
        assert str(run.reason.item()) in " ".join(cells[f"williamson5-{number}"])


def test_every_cell_of_the_table_has_the_numbers_of_its_row(dataset, text):
    cells = re.findall(
        r'<a href="#williamson5-(\d+)">(?:[★≈] )?(\S+)&nbsp;s, <br>(\S+)&nbsp;s, <br>(\S+)</a>',
        text,
    )
    assert len(cells) > 20
    for number, dt, cost, error in cells:
        run = dataset.isel(run=int(number) - 1)
        assert float(dt) == pytest.approx(run.dt.item(), rel=1e-3)
        assert float(cost) == pytest.approx(run.cpu_seconds.item(), rel=0.06)
        known = run.error.sel(norm="l2").values
        assert np.any(np.isclose(known[np.isfinite(known)], float(error), rtol=0.06))


def test_the_page_begins_with_a_sentence_and_one_table(text):
    body = text[text.index("<main>") : text.index("<details>")]
    assert body.count("<table") == body.count('class="card headline"') == 1
    assert body.index("headline") < body.index("<table") < body.index("<img")
    assert "too close to rank" not in text
    assert body.count("<img") == 2


@pytest.mark.usefixtures("blank_figures")
def test_html_and_markdown_say_the_same(dataset, text, tmp_path):
    (ranked,) = sweep_rankings(dataset)
    write_report(dataset, tmp_path, recipe=Recipe("Steps", ()))
    page = (tmp_path / "README.md").read_text(encoding="utf-8")
    plain = re.sub(r"<[^>]*>", "", text).replace("&nbsp;", " ")
    for sentence in (ranked.headline, *(cell for line in ranked.body for cell in line)):
        assert sentence in page
        assert sentence in plain.replace("&lt;", "<")


def test_the_page_tells_how_it_was_made_and_what_to_doubt(text):
    for part in ("a machine, 2 cores", "warp 1.19.0",
                 "ranked by the CPU time", "about 2.4e-7 (Richardson)"):  # fmt: skip
        assert part in text, part


@pytest.mark.usefixtures("blank_figures")
def test_pages_are_known_as_those_of_sweeps(folder, dataset, tmp_path):
    """By what `swe-sphere sweep` looks for before it replaces one."""
    assert MARK in (folder / REPORT).read_text(encoding="utf-8")[:200]
    write_report(dataset.isel(run=[3]), tmp_path, recipe=Recipe("Steps", ()))
    assert MARK in (tmp_path / PAGE).read_text()


def test_figures_lie_beside_the_page(folder):
    drawn = sorted(folder.glob("*.svg"))
    assert len(drawn) > 5
    for path in drawn:
        root = ElementTree.parse(path).getroot()
        assert root.tag.endswith("svg")
        assert path.stat().st_size < 60_000


@pytest.mark.usefixtures("blank_figures")
def test_a_figure_that_no_sweep_has_made_is_not_replaced(dataset, tmp_path):
    """Also beside a page of a sweep."""
    folder = write_report(dataset, tmp_path).parent
    page, figure = folder / "index.html", next(folder.glob("*.svg"))
    shown = page.read_bytes()
    assert MARK in figure.read_text()
    figure.write_text("<svg>mine</svg>")
    with pytest.raises(ConfigError, match=rf"{figure.name} is not of a sweep, and would be"):
        write_report(dataset, tmp_path, recipe=Recipe("another", ()))
    assert figure.read_text() == "<svg>mine</svg>" and page.read_bytes() == shown


def test_a_figure_is_the_same_bytes_each_time(dataset):
    rows = read_runs(dataset)
    first, again = (next(error_pictures(rows, metrics(rows)[0], "a")).svg for _ in range(2))
    assert first == again


@pytest.mark.parametrize(
    ("runs", "expected"),
    [
        (({"status": "unstable", "reason": "<wind> & waves"},), "&lt;wind&gt; &amp; waves"),
        ((SMALL | {"errors": {("time", "h"): 0.0}, "spread": np.nan},), "completed"),
        ((SMALL | {"errors": {("total", "h"): 1e-3}, "stepper": "<i>mine</i>"},), "&lt;i&gt;mine"),
        (({"gravity_limit": np.nan, "steps": np.nan},), "completed"),
    ],
)
def test_small_and_odd_datasets_make_a_page(runs, expected, tmp_path):
    page = write_report(make_sweep(*runs), tmp_path, recipe=Recipe("", ())).read_text("utf-8")
    Page(page)
    assert expected in page
    assert (tmp_path / "README.md").read_text("utf-8").count("\n## williamson5, ne16 np4") == 1


@pytest.mark.usefixtures("blank_figures")
def test_several_datasets_make_one_page_with_an_answer_for_each(tmp_path):
    small = SMALL | {"errors": {("total", "h"): 1e-3}}
    other = make_sweep(small | {"scene": "lauter"}, scene="lauter")
    page = write_report(
        {"williamson5": make_sweep(small), "lauter": other}, tmp_path,
        recipe=Recipe("Two", (), notes={"lauter": "A **remark**, 2 < 3."}),
    ).read_text(encoding="utf-8")  # fmt: skip
    Page(page)
    head = page[page.index("<header>") : page.index("</header>")]
    assert "<h1>Two</h1>" in head
    assert "Cheapest to l2(h) ≤ 1e-3 (total error, day 15) on williamson5, ne16 np4: rk4" in head
    assert 'href="#lauter-1"' in head
    assert "<p>A <strong>remark</strong>, 2 &lt; 3.</p>" in page


def test_the_headline_is_on_the_slow_flow_where_its_error_is_known(dataset):
    (section,) = read_sections(dataset)
    head = "Cheapest to l2(potential vorticity) ≤ 1e-4 (slow-flow error"
    assert section.headline.startswith(head)
    without = dataset.assign(error=dataset.error.where(dataset.kind != "slow"))
    (section,) = read_sections(without)
    assert section.headline.startswith("Cheapest to l2(h) ≤ 3e-4 (total error")


@pytest.mark.usefixtures("blank_figures")
def test_the_meshes_of_a_dataset_are_told_apart(tmp_path):
    small = SMALL | {"errors": {("total", "h"): 1e-3}}
    runs = (small, small | {"ne": 8}, small | {"stretch": 4.0})
    page = write_report(make_sweep(*runs), tmp_path).read_text(encoding="utf-8")
    for mesh in ("ne16 np4", "ne8 np4", "ne16 np4, stretched 4"):
        assert f"<h2>williamson5, {mesh}</h2>" in page
    assert Page(page).ids.count("williamson5-3") == 1


@pytest.mark.parametrize("names", [("x y", "x-y"), ("ä", "ö"), ("a0.1", "a0-1"), ("A", "a")])
def test_sweeps_with_similar_names_keep_their_figures_and_anchors(tmp_path, names):
    runs = {name: plausible_sweep(seed=k) for k, name in enumerate(names)}
    recipe = Recipe("Steps", ())
    text = write_report(runs, tmp_path, recipe=recipe).read_text(encoding="utf-8")
    ids = Page(text).ids
    assert len(ids) == len({*ids})
    sections = read_sections(runs)
    pictures = [each.name for of in sections for each in of.others]
    assert len(pictures) == len({*pictures}) and sections[1].name.startswith(sections[1].anchor)


def test_a_folder_that_cannot_be_made_is_one_clear_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot write the report to"):
        write_report(make_sweep({}), tmp_path / "file")


@pytest.mark.usefixtures("blank_figures")
def test_the_page_of_the_documentation(dataset, tmp_path):
    recipe = Recipe("Steps", (), "Made by a command.", {"williamson5": "What differs."})
    runs = dataset.isel(run=[3, 4, 8, 15, 16, 34, 35])
    write_report({"williamson5": runs}, tmp_path, recipe=recipe)
    text = (tmp_path / "README.md").read_text(encoding="utf-8")
    assert text.startswith("# Steps\n\nMade by a command.\n\n## williamson5, ne16 np4\n")
    pictures = re.findall(r'<img src="([^"]*)"', text)
    assert len(pictures) == len(set(pictures)) == 6
    assert {path.name for path in tmp_path.glob("*.svg")} == {*pictures}
    assert "What differs." in text
    assert "t = 86400 s \\| 30 iterations" in text
    _check_tables(text)


def _check_tables(text):
    for table in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        widths = {len(re.findall(r"(?<!\\)\|", line)) for line in table.splitlines()}
        assert len(widths) == 1
        assert re.fullmatch(r"\|(---\|)+", table.splitlines()[1])
    assert len(re.findall(r"^\|(---\|)+$", text, re.MULTILINE)) == 3


def test_templates_are_part_of_the_package():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    patterns = project["tool"]["setuptools"]["package-data"]["swe_sphere.studies.report"]
    folder = ROOT / "swe_sphere/studies/report"
    files = [path for path in folder.rglob("*") if path.is_file()]
    others = [path.relative_to(folder) for path in files if path.suffix not in (".py", ".pyc")]
    assert others
    assert all(any(fnmatch(str(path), pattern) for pattern in patterns) for path in others)


@pytest.mark.parametrize(
    ("value", "expected"),
    [(3.14159, "3.14"), (0.0, "0"), (1234.5, "1234"), (0.01234, "0.0123"), (-2.0, "−2.00"),
     (float("nan"), "–"), (1e-9, "1.00e-9"), (3e7, "3.00e7"), (0.99999, "1.000")],
)  # fmt: skip
def test_numbers_are_written_short(value, expected):
    assert words.number(value) in (expected, expected.rstrip("0"))


@pytest.mark.parametrize(
    ("value", "expected"),
    [(1e-3, "1e-3"), (2.5e-4, "2.5e-4"), (6.25e-4, "6.25e-4"), (1.0 / 3.0, "3.33e-1"), (0.0, "0")],
)
def test_levels_have_the_digits_that_tell_them_apart(value, expected):
    assert words.level(value) == expected


@pytest.mark.parametrize(
    ("value", "expected"),
    [(3.44e-5, "3.4e-5"), (0.0, "0"), (-1e-10, "−1.0e-10"), (2.0, "2.0"), (float("inf"), "–")],
)
def test_errors_are_written_with_an_exponent(value, expected):
    assert words.error(value) == expected
