from __future__ import annotations

import html
import json
import math
import re
import shutil
import subprocess
from typing import TYPE_CHECKING

import pandas as pd
import pytest

from feel321.analysis.page import inline_svg
from feel321.analysis.report.front import split_lines
from feel321.analysis.report.section import Picture, Section, make_slug, name_pictures
from feel321.analysis.resampling import METHODS
from feel321.analysis.screening.rules import RULES
from feel321.analysis.words import (
    Line,
    format_interval,
    format_method,
    format_number,
    keep_together,
)

if TYPE_CHECKING:
    from pathlib import Path


KINDS = {format_method(method): method for method in METHODS}


def load(report: Path) -> dict[str, object]:
    return json.loads((report / "results.json").read_text(encoding="utf-8"))


def gather_rows(report: Path) -> list[list[dict[str, str]]]:
    """Read the page's tables: per table, per row, cell by column; what came twice is told apart by its place."""
    text = re.sub(
        r"<svg.*?</svg>", "", (report / "index.html").read_text(encoding="utf-8"), flags=re.DOTALL
    )
    tables = []
    for table in re.findall(r"<table>.*?</table>", text, flags=re.DOTALL):
        header, *rows = [
            [
                " ".join(html.unescape(cell).split())
                for cell in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.DOTALL)
            ]
            for row in re.findall(r"<tr>(.*?)</tr>", table, flags=re.DOTALL)
        ]
        header = [
            f"{name} of z" if name in header[:place] else name for place, name in enumerate(header)
        ]
        tables.append([dict(zip(header, row, strict=True)) for row in rows])
    return tables


def pair(entry: dict[str, object], kind: str = "correlation") -> str:
    return format_interval(
        *(math.nan if entry[key] is None else entry[key] for key in ("low", "high")), kind=kind
    )


def single(entry: dict[str, object], kind: str = "correlation") -> str:
    return format_number(math.nan if entry["value"] is None else entry["value"], kind=kind)


def test_every_cell_stands_under_its_header(report: Path) -> None:
    found = {entry["name"]: entry for entry in load(report)["numbers"]}
    tables = gather_rows(report)
    heads = ("r / ceiling", "Difference of r", "Judgements")
    correlations, differences, profiles = (
        next(table for table in tables if head in table[0]) for head in heads
    )
    # Scales x metrics x methods.
    assert (len(correlations), len(differences), len(profiles)) == (2 * 2 * 6, 2 * 6, 24)
    for row in correlations:
        scale, metric = row["Ratings"].split(",")[0], row["Metric"].replace(" ", "_")
        name = f"association.{scale}.as_is.{metric}.{KINDS[row['Method']]}"
        assert row["r"] == single(found[name])
        assert row["Two-way interval"] == pair(found[name])
        assert row["Participants only"] == pair(found[f"{name}.participants_only"])
        assert row["Noise ceiling"] == single(found[f"{name}.ceiling"])
        assert row["r / ceiling"] == single(found[f"{name}.disattenuated"])
        for column, what in (
            ("Stimuli", "items"),
            ("Participants", "participants"),
            ("Recordings", "recordings"),
        ):
            assert row[column] == f"{found[f'{name}.n_{what}']['value']}"
        assert row["Draws"] == f"{found[f'{name}.draws']['value']}"
    for row in differences:
        scale, *pairs = row["Ratings"].split(",")[0], row["First"], row["Second"]
        name = (
            f"difference.{scale}.as_is.{'.'.join(pairs).replace(' ', '_')}.{KINDS[row['Method']]}"
        )
        assert row["Difference of r"] == single(found[name])
        assert row["Two-way interval"] == pair(found[name])
        assert row["Difference of Fisher’s z"] == single(found[f"{name}.z"])
        assert row["Two-way interval of z"] == pair(found[f"{name}.z"])
    for row in profiles:
        name = f"profile.{row['Ratings'].split(',')[0]}.as_is.{row['Role']}.{row['Reducer']}"
        assert row["Mean"] == single(found[name], "rating")
        assert row["Interval"] == pair(found[name], "rating")
        for column, what in (
            ("Participants", "participants"),
            ("Stimuli", "stimuli"),
            ("Judgements", "ratings"),
        ):
            assert row[column] == f"{found[f'{name}.n_{what}']['value']}"


def test_every_caption_has_its_own_drawing(report: Path) -> None:
    figures = load(report)["figures"]
    text = (report / "index.html").read_text(encoding="utf-8")
    shown = re.findall(
        r"<figure[^>]*>.*?<svg(.*?)</svg>.*?<figcaption>(.*?)</figcaption>", text, flags=re.DOTALL
    )
    drawings = {
        html.unescape(caption): re.findall(r' d="([^"]*)"', drawing) for drawing, caption in shown
    }
    assert set(drawings) == set(map(keep_together, figures.values()))
    for name, caption in figures.items():
        drawn = (report / "figures" / f"{name}.svg").read_text(encoding="utf-8")
        assert drawings[keep_together(caption)] == re.findall(r' d="([^"]*)"', drawn)
    assert len({tuple(paths) for paths in drawings.values()}) == len(figures)


def test_differences_and_clipped_values_are_in_the_results(report: Path, study: object) -> None:
    results = load(report)
    found = {entry["name"]: entry["value"] for entry in results["numbers"]}
    name = "difference.realism.as_is.spectral_match.temporal_match.pearson"
    assert found[f"{name}.first_value"] == found["association.realism.as_is.spectral_match.pearson"]
    assert (
        found[f"{name}.second_value"] == found["association.realism.as_is.temporal_match.pearson"]
    )
    assert found[name] == found[f"{name}.first_value"] - found[f"{name}.second_value"]
    assert (found[f"{name}.draws"], found[f"{name}.n_missing"]) == (50, 0)
    lowest = pd.read_csv(study.manifest).query("role == 'test'")["spectral_match"].min()
    assert found["scatter.realism.as_is.spectral_match.lowest"] == lowest
    assert "jinja2" in results["versions"]
    assert results["inputs"]["draws"] == "50"


@pytest.mark.skipif(
    not shutil.which("chromium"), reason="PAGE NOT RENDERED: chromium is not installed"
)
@pytest.mark.parametrize("width", [500, 1400])
def test_a_browser_shows_it_without_overflow(report: Path, tmp_path: Path, width: int) -> None:
    probe = "document.title = document.documentElement.scrollWidth + ' of ' + innerWidth"
    page = (
        (report / "index.html")
        .read_text(encoding="utf-8")
        .replace("</body>", f"<script>{probe}</script></body>")
    )
    (tmp_path / "probe.html").write_text(page, encoding="utf-8")
    quiet = [
        "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-sync",
        "--disable-component-update", "--no-first-run", f"--user-data-dir={tmp_path / 'profile'}",
    ]  # fmt: skip
    address = (tmp_path / "probe.html").as_uri()
    command = ["chromium", *quiet, f"--window-size={width},900", "--dump-dom", address]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout
    wide, window = map(int, re.search(r"<title>(\d+) of (\d+)</title>", shown).groups())
    assert wide <= window
    assert window <= width


def test_no_line_breaks_between_a_number_and_its_percent_sign(report: Path) -> None:
    text = re.sub(
        r"<svg.*?</svg>", "", (report / "index.html").read_text(encoding="utf-8"), flags=re.DOTALL
    )
    assert len(re.findall("95\N{NO-BREAK SPACE}% ", text)) > 20
    assert re.findall(r"\d\s*[ \n]\s*%", text) == []


def test_notes_hold_words_instead_of_raw_names(report: Path) -> None:
    notes = [note for note in load(report)["notes"] if "as is" in note]
    assert notes
    assert not any(rule in note for note in load(report)["notes"] for rule in RULES if "_" in rule)
    assert not any(
        name in note for note in notes for name in ("as_is", "spectral_match", "Intercept")
    )


def test_what_scales_share_is_said_once_and_nothing_is_lost() -> None:
    same = [Line("x", "Realism", "evidence"), Line("x", "MUSHRA", "evidence"), Line("all")]
    own = [Line(f"{number}", f"Scale {number}", "pooled") for number in range(4)]
    section = Section("a", "A", answers=("in words",), verdict=(*same, *own))
    shown, folded = split_lines(section)
    assert shown == ["Realism and MUSHRA, evidence: x", "All"]
    # A sentence of their own for each of four scales gives way to tables.
    assert folded == [*map(str, own), "in words"]
    assert split_lines(Section("paper", "A", verdict=own)) == ([*map(str, own)], [])


def test_every_sentence_of_the_results_is_on_the_page(report: Path) -> None:
    results = load(report)
    page = (report / "index.html").read_text(encoding="utf-8")
    text = html.unescape(re.sub(r"<svg.*?</svg>", "", page, flags=re.DOTALL)).casefold()
    met = re.sub(r"<details.*?</details>", "", text, flags=re.DOTALL)
    for line in [*results["verdict"], *(one for own in results["answers"].values() for one in own)]:
        assert keep_together(line.split(": ", 1)[-1]).casefold() in text
    # Met first, and not folded: the sentence, the cards, the slopes; then the correlations.
    order = [
        keep_together(results["headline"]).casefold(), 'class="card"', "points per +0.1",
        "correlations of mean ratings with metrics", 'id="computed"',
    ]  # fmt: skip
    places = [met.index(one) for one in order]
    assert places == sorted(places)
    # Every fold is named by what is in it.
    folds = re.findall(r"<details[^>]*>\s*<summary>(.*?)</summary>", text)
    assert len(folds) == len(set(folds)) > 5


def test_figures_keep_their_names_when_others_come(report: Path) -> None:
    def name(*scales: str) -> dict[str, str]:
        pictures = [Picture(make_slug("scatter", scale, "as_is"), scale, None) for scale in scales]
        named = list(name_pictures(pictures))
        assert len({one.name.casefold() for one in named}) == len(scales)
        return {one.caption: one.name for one in named}

    few = name("realism", "Wie echt?", "Wie echt!", "A" * 50, "A" * 51)
    more = name("mushra", "realism", "a-b", "A-b", *list(few)[1:])
    assert few["realism"] == "scatter_realism_as_is"
    assert few.items() <= more.items()
    assert not any(re.search(r"_\d+$", name) for name in load(report)["figures"])


def test_a_drawing_takes_the_colours_of_its_page(report: Path) -> None:
    files = sorted((report / "figures").glob("*.svg"))
    assert files
    for file in files:
        text = file.read_text(encoding="utf-8")
        assert "<text" in text  # words stay words
        assert "#000000" in text
        inline = str(inline_svg(file.stem, "a < b", file))
        assert 'aria-label="a &lt; b"' in inline
        assert not re.search("#000000|#ffffff", inline)
        ids = re.findall(r'\bid="([^"]*)"', inline)
        assert all(one.startswith(f"{file.stem}-") for one in ids)
        assert set(re.findall(r'(?:href="|url\()#([^")]*)', inline)) <= set(ids)
