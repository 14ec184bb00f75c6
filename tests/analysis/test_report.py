from __future__ import annotations

import csv
import json
import math
import re
import shutil
from functools import partial
from html.parser import HTMLParser
from itertools import pairwise, product
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd
import pytest
from scipy import stats

from feel321.analysis.contrasts.discrimination import discriminate
from feel321.analysis.figures.scatter import draw_discrimination
from feel321.analysis.report import folder
from feel321.analysis.report.folder import ResultsFolder, list_files
from feel321.analysis.report.section import Picture
from feel321.analysis.report.write import write_report
from feel321.analysis.words import PLACES, format_number

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure

NUMBER = re.compile(r"(?<![\w.])[−-]?\d+(?:\.\d+)?(?![\w])")
"""A number that stands alone: neither the 321 of dft321 nor a version's parts."""


class Page(HTMLParser):
    """What a page says outside its drawings and style, and which tags and ids it has."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.words, self.tags, self.ids, self.hidden = [], [], [], 0
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self.ids += [value for name, value in attrs if name == "id"]
        self.hidden += tag in {"svg", "style", "script"}

    def handle_endtag(self, tag: str) -> None:
        self.hidden -= tag in {"svg", "style", "script"}

    def handle_data(self, data: str) -> None:
        if not self.hidden:
            self.words.append(data)

    def find(self, tag: str) -> list[dict[str, str | None]]:
        return [attrs for name, attrs in self.tags if name == tag]


@pytest.fixture
def own_report(report: Path, tmp_path: Path) -> Path:
    """Copy the report for a test that writes."""
    return Path(shutil.copytree(report, tmp_path / "report"))


def load(report: Path) -> dict[str, object]:
    def refuse(name: str) -> None:
        raise ValueError(f"{name} is no JSON")

    return json.loads((report / "results.json").read_text(encoding="utf-8"), parse_constant=refuse)


def gather_strings(content: object) -> list[str]:
    if isinstance(content, str):
        return [content]
    parts = (
        content.values()
        if isinstance(content, dict)
        else content
        if isinstance(content, list)
        else ()
    )
    return [text for part in parts for text in gather_strings(part)]


def gather_numbers(results: dict[str, object]) -> set[str]:
    """List every number of the results in every way that it may be written."""
    values = {entry[key] for entry in results["numbers"] for key in ("value", "low", "high")} - {
        None
    }
    return {
        word
        for value in values
        for kind in PLACES
        for word in NUMBER.findall(format_number(value, kind=kind))
    }


def test_the_page_shows_no_number_that_is_not_in_the_results(report: Path) -> None:
    results = load(report)
    spoken = [results[key] for key in ("how", "figures", "captions", "notes", "inputs", "versions")]
    allowed = gather_numbers(results) | set(NUMBER.findall(" ".join(gather_strings(spoken))))
    shown = set(NUMBER.findall(" ".join(Page(report / "index.html").words)))
    assert len(shown) > 100
    assert shown - allowed == set()


def test_the_verdict_speaks_in_numbers_of_the_results(report: Path) -> None:
    results = load(report)
    spoken = set(NUMBER.findall(" ".join(results["verdict"])))
    assert spoken - gather_numbers(results) <= {"95", "0.1", "1"}  # 95 % intervals, per +0.1, eq. 1


def test_every_number_says_what_it_is(report: Path) -> None:
    numbers = load(report)["numbers"]
    names = [entry["name"] for entry in numbers]
    assert len(names) == len(set(names))
    for entry in numbers:
        first = [
            "name",
            "family",
            "scale",
            "level",
            "metric",
            "statistic",
            "keys",
            "value",
            "low",
            "high",
        ]
        assert list(entry) == [*first, "uncertainty", "method", "n", "status"]
        assert entry["status"] == "exploratory"  # nothing was frozen
        assert entry["method"]
        assert isinstance(entry["n"], int)
        assert bool(entry["uncertainty"]) == (entry["low"] is not None)


def test_numbers_are_those_of_the_files(report: Path, study: object) -> None:
    manifest = pd.read_csv(study.manifest, index_col="stimulus_id")
    manifest = manifest[manifest["role"] == "test"]
    ratings = pd.read_csv(study.ratings).query("scale == 'similarity'")
    means = ratings.groupby("stimulus_id")["rating"].mean()[manifest.index]
    found = {entry["name"]: entry for entry in load(report)["numbers"]}
    r = found["association.similarity.as_is.temporal_match.spearman"]["value"]
    assert r == pytest.approx(stats.spearmanr(means, manifest["temporal_match"]).statistic)
    assert found["stimulus.similarity.as_is.rec0_dft321_as_is"]["value"] == pytest.approx(
        means["rec0_dft321_as_is"]
    )
    assert found["size.judgements"]["value"] == 1152


def test_the_same_seed_gives_the_same_bytes_whoever_draws(
    report: Path, study: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("feel321.analysis.report.folder.BACKGROUND", True)
    write_report(study.ratings, study.manifest, tmp_path / "again", draws=50, rng=3)
    paths = [path.relative_to(report) for path in sorted(report.rglob("*")) if path.is_file()]
    assert {path.as_posix() for path in paths} == set(load(report)["files"])
    for path in paths:
        assert (report / path).read_bytes() == (tmp_path / "again" / path).read_bytes(), path


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize(
    "scales",
    [
        ("粗さ", "硬さ"),
        ("very rough", "very-rough"),
        ("Realism", "realism"),
        ("x" * 300, "x" * 300 + "y"),
    ],
)
def test_every_figure_has_a_file_of_its_own(
    files: Callable[..., object], tmp_path: Path, scales: tuple[str, ...]
) -> None:
    study = files(scales=scales, recordings=3, anchors=False)
    results = write_report(study.ratings, study.manifest, tmp_path / "report", draws=20, rng=0)
    drawn = {path.stem.casefold() for path in (tmp_path / "report" / "figures").glob("*.svg")}
    assert len(drawn) == len(results.figures) == len(set(results.figures.values())) == 7
    unknown = [note for note in results.notes if "font has no" in note]
    assert len(unknown) == (scales[0] == "粗さ")
    assert all("さ 硬 粗" in note for note in unknown)


@pytest.mark.usefixtures("short")
def test_another_seed_moves_intervals_only(report: Path, study: object, tmp_path: Path) -> None:
    write_report(study.ratings, study.manifest, tmp_path / "other", draws=50, rng=4)
    first = {entry["name"]: entry for entry in load(report)["numbers"]}
    second = {entry["name"]: entry for entry in load(tmp_path / "other")["numbers"]}
    assert {name: first[name]["value"] for name in second} == {
        name: entry["value"] for name, entry in second.items()
    }
    moved = [name for name, entry in second.items() if first[name]["low"] != entry["low"]]
    assert moved
    assert all(name.startswith(("association", "difference")) for name in moved)


OURS = [{"type": "application/json", "id": "points"}, {}]
"""The page's scripts: data, and what reads it; none of them is loaded."""


def test_the_page_stands_alone(report: Path) -> None:
    page = Page(report / "index.html")
    text = (report / "index.html").read_text(encoding="utf-8")
    namespaces = {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}
    assert set(re.findall(r"https?://[^\s\"'<>]+", text)) <= namespaces
    assert page.find("script") == OURS
    assert [link["href"] for link in page.find("link")] == ["data:,"]  # no icon is asked for
    assert not page.find("img")
    assert len(page.ids) == len(set(page.ids))


def test_the_page_reads_well_without_eyes(report: Path) -> None:
    page = Page(report / "index.html")
    assert page.find("html")[0]["lang"] == "en"
    results = load(report)
    strips = [svg for svg in page.find("svg") if svg.get("class") == "strip"]
    drawn = len(page.find("svg")) - len(strips)
    assert drawn == len(page.find("figcaption")) == len(results["figures"])
    assert len(strips) == len(results["cards"])
    assert all(svg["role"] == "img" and svg["aria-label"] for svg in page.find("svg"))
    assert len(page.find("table")) == len(page.find("caption")) == len(results["captions"])
    assert all(cell.get("scope") for cell in page.find("th"))
    levels = [int(tag[1]) for tag, _ in page.tags if tag in {"h1", "h2", "h3", "h4"}]
    assert levels.count(1) == 1 == levels[0]
    assert all(below <= above + 1 for above, below in pairwise(levels))
    links = [link["href"].removeprefix("#") for link in page.find("a") if "class" not in link]
    assert len(links) == len(set(links) & set(page.ids)) > 4


@pytest.mark.usefixtures("short")
def test_far_outliers_are_told_in_the_caption(files: Callable[..., object], tmp_path: Path) -> None:
    study = files(scales=("realism",), anchors=False)
    manifest = pd.read_csv(study.manifest)
    manifest.loc[[3, 11], "spectral_match"] = [-1.5, -40.0]
    manifest.to_csv(study.manifest, index=False)
    results = write_report(study.ratings, study.manifest, tmp_path / "report", draws=20, rng=0)
    told = "left edge: 2 with spectral match below −1; r uses their true values"
    assert told in results.figures["scatter"]
    found = {number.name: number.value for number in results.numbers}
    assert found["scatter.realism.as_is.spectral_match.n_below_edge"] == 2
    assert found["scatter.realism.as_is.temporal_match.n_below_edge"] == 0


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize("simulated", [True, False])
def test_simulated_ratings_carry_a_banner(
    files: Callable[..., object], tmp_path: Path, simulated: bool
) -> None:
    study = files(simulated=simulated, scales=("realism",))
    results = write_report(study.ratings, study.manifest, tmp_path / "report", draws=20, rng=0)
    text = (tmp_path / "report" / "index.html").read_text(encoding="utf-8")
    assert results.simulated == simulated
    assert ("Simulated ratings" in text) == simulated


@pytest.mark.usefixtures("short")
def test_dots_in_names_make_no_two_numbers_one(
    files: Callable[..., object], tmp_path: Path
) -> None:
    study = files(scales=("a", "a.b"), recordings=3, anchors=False)
    manifest, ratings = pd.read_csv(study.manifest), pd.read_csv(study.ratings)
    manifest["reducer"] = manifest["reducer"].replace("mag321", "dft321.n_stimuli")
    level = dict(zip(["rec0", "rec1", "rec2"], ["c", "b.c", "b.c"], strict=True))
    manifest["level"] = manifest["recording"].map(level)
    manifest.to_csv(study.manifest, index=False)
    ratings.drop(columns=["reducer", "level"]).to_csv(study.ratings, index=False)
    results = write_report(study.ratings, study.manifest, tmp_path / "report", draws=20, rng=0)
    names = [number.name for number in results.numbers]
    assert len(names) == len(set(names))
    assert {
        "profile.a%2Eb.c.test.dft321%2En_stimuli",
        "profile.a.b%2Ec.test.dft321.n_stimuli",
    } <= set(names)


@pytest.mark.usefixtures("short")
def test_two_numbers_of_one_name_are_refused(
    study: object, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(
        "feel321.analysis.report.section._fill", lambda path, _: path.partition(".")[0]
    )
    with pytest.raises(ValueError, match=r"results: got \d+ names twice, first association"):
        write_report(study.ratings, study.manifest, tmp_path / "report", draws=5, rng=0)


@pytest.mark.usefixtures("short")
def test_levels_are_kept_apart(files: Callable[..., object], tmp_path: Path) -> None:
    study = files(levels=("as_is", "equal_intensity"), scales=("realism",), anchors=False)
    results = write_report(study.ratings, study.manifest, tmp_path / "report", draws=20, rng=0)
    assert sum("level equal intensity" in line for line in results.answers["metrics"]) == 1
    kinds = [path.stem.split("_")[0] for path in (tmp_path / "report" / "figures").glob("*.svg")]
    assert {kind: kinds.count(kind) for kind in kinds} == {"scatter": 2, "mapping": 4, "profile": 1}


@pytest.mark.usefixtures("short")
def test_captions_speak_of_what_is_there(
    files: Callable[..., object], report: Path, tmp_path: Path
) -> None:
    whole = load(report)["figures"]
    scatter, raincloud = whole["scatter"], whole["profile"]
    assert "over the 6 participants who rated it" in scatter
    assert "Below the dotted line: the hidden reference and anchors." in raincloud
    study = files(participants=1, scales=("realism",), anchors=False)
    results = write_report(study.ratings, study.manifest, tmp_path / "report", draws=5, rng=0)
    for caption in results.figures.values():
        assert "no intervals" in caption
        assert "t intervals" not in caption
        assert "dotted line" not in caption
    assert not any("t interval" in number.uncertainty for number in results.numbers)


def test_every_metric_is_drawn_recording_by_recording_with_its_mapping_and_ceiling(
    report: Path,
) -> None:
    results, table = load(report), pd.read_csv(report / "tables" / "p1401.csv")
    found = {entry["name"]: entry["value"] for entry in results["numbers"]}
    for scale, metric in product(("realism", "similarity"), ("spectral_match", "temporal_match")):
        drawn = [
            name
            for name in results["figures"]
            if name.startswith(f"mapping_{scale}_as_is_{metric}")
        ]
        assert len(drawn) == 1
        assert {path.suffix for path in (report / "figures").glob(f"{drawn[0]}.*")} == {
            ".svg",
            ".png",
        }
        asked = "scale == @scale and metric == @metric and order == 3 and not held_out"
        fitted = [float(value) for value in table.query(asked)["coefficients"].item().split()]
        shown = [found[f"mapping.{scale}.as_is.{metric}.coefficient_{power}"] for power in range(4)]
        assert shown == pytest.approx(fitted, rel=1e-5, abs=1e-5)


def test_left_out_judgements_are_counted(report: Path) -> None:
    assert {
        "Associations leave out 192 judgements of stimuli with role 'anchor'.",
        "Associations leave out 96 judgements of stimuli with role 'reference'.",
    } < set(load(report)["notes"])


def test_a_reduced_analysis_is_a_report_too(files: Callable[..., object], tmp_path: Path) -> None:
    study = files(participants=1, recordings=1, scales=("realism",), anchors=False)
    results = write_report(study.ratings, study.manifest, tmp_path / "report", draws=20, rng=0)
    assert any("One participant only" in note for note in results.notes)
    lows = [number.low for number in results.numbers if number.name.startswith("association")]
    assert all(math.isnan(low) for low in lows)
    assert '"low": null' in (tmp_path / "report" / "results.json").read_text(encoding="utf-8")
    text = (tmp_path / "report" / "index.html").read_text(encoding="utf-8")
    assert "nan" not in re.sub(r"<svg.*?</svg>", "", text, flags=re.DOTALL)
    assert "Nothing." not in text


@pytest.mark.usefixtures("short")
def test_nothing_left_out_is_said_too(files: Callable[..., object], tmp_path: Path) -> None:
    study = files(anchors=False, scales=("realism",))
    write_report(study.ratings, study.manifest, tmp_path / "report", draws=20, rng=0)
    assert "<p>Nothing.</p>" in (tmp_path / "report" / "index.html").read_text(encoding="utf-8")


def test_constant_ratings_are_a_report_too(files: Callable[..., object], tmp_path: Path) -> None:
    study = files(scales=("realism",))
    pd.read_csv(study.ratings).assign(rating=50).to_csv(study.ratings, index=False)
    results = write_report(study.ratings, study.manifest, tmp_path / "report", draws=20, rng=0)
    assert results.verdict[0].endswith("cannot be estimated: all ratings are the same.")
    assert {claim.verdict for claim in results.verdicts} == {"not_estimable"}


@pytest.mark.usefixtures("short")
def test_ratings_of_anchors_alone_are_refused(files: Callable[..., object], tmp_path: Path) -> None:
    study = files()
    ratings = pd.read_csv(study.ratings)
    ratings[ratings["reducer"] == "anchor_low"].to_csv(study.ratings, index=False)
    with pytest.raises(ValueError, match="must be of one stimulus or more with role 'test'"):
        write_report(study.ratings, study.manifest, tmp_path / "report", draws=20, rng=0)
    assert not (tmp_path / "report").exists()


@pytest.mark.usefixtures("short")
def test_names_cannot_break_the_page(files: Callable[..., object], tmp_path: Path) -> None:
    study = files(scales=("<script>alert(1)</script>--><b>",), anchors=False)
    write_report(study.ratings, study.manifest, tmp_path / "report", draws=20, rng=0)
    assert Page(tmp_path / "report" / "index.html").find("script") == OURS


@pytest.mark.usefixtures("short")
def test_an_old_report_is_replaced_and_other_files_stay(
    own_report: Path, files: Callable[..., object]
) -> None:
    (own_report / "notes.txt").write_text("mine", encoding="utf-8")
    study = files(scales=("realism",))
    write_report(study.ratings, study.manifest, own_report, draws=20, rng=0)
    assert not list((own_report / "figures").glob("*similarity*"))
    assert (own_report / "notes.txt").read_text(encoding="utf-8") == "mine"


@pytest.mark.usefixtures("short")
def test_files_of_the_same_folders_that_are_not_ours_stay(study: object, tmp_path: Path) -> None:
    for name in ("figures/photo.png", "tables/mine.csv", "thesis.txt"):
        (tmp_path / "mine" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "mine" / name).write_text("mine", encoding="utf-8")
    for _ in range(2):
        write_report(study.ratings, study.manifest, tmp_path / "mine", draws=5, rng=0)
        for name in ("figures/photo.png", "tables/mine.csv", "thesis.txt"):
            assert (tmp_path / "mine" / name).read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(
    "results", [None, "no JSON", "[]", '{"files": ["figures/../../precious.csv"]}']
)
def test_a_file_in_the_way_is_never_replaced(
    study: object, tmp_path: Path, results: str | None
) -> None:
    page = tmp_path / "mine" / "index.html"
    page.parent.mkdir()
    page.write_text("mine", encoding="utf-8")
    if results:
        (page.parent / "results.json").write_text(results, encoding="utf-8")
    (tmp_path / "precious.csv").write_text("1", encoding="utf-8")
    with pytest.raises(
        FileExistsError, match="is not of a former report; move it away or choose another folder"
    ):
        write_report(study.ratings, study.manifest, page.parent, draws=5, rng=0)
    assert page.read_text(encoding="utf-8") == "mine"
    assert not (page.parent / "figures").exists()
    assert (tmp_path / "precious.csv").exists()


def test_every_file_is_listed(report: Path) -> None:
    found = {path.relative_to(report).as_posix() for path in report.rglob("*") if path.is_file()}
    assert found == set(load(report)["files"])


@pytest.mark.usefixtures("short")
def test_a_failed_run_changes_nothing(
    own_report: Path, files: Callable[..., object], monkeypatch: object
) -> None:
    before = {path: path.read_bytes() for path in own_report.rglob("*") if path.is_file()}
    study = files(seed=9, scales=("realism",))
    monkeypatch.setattr("feel321.analysis.report.write.render_page", lambda *_, **__: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_report(study.ratings, study.manifest, own_report, draws=20, rng=0)
    assert before == {path: path.read_bytes() for path in own_report.rglob("*") if path.is_file()}
    assert [
        path.name for path in own_report.parent.iterdir() if path.name.startswith(".report-")
    ] == []


def test_tables_hold_the_same_numbers(report: Path) -> None:
    with (report / "tables" / "associations.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    found = {entry["name"]: entry for entry in load(report)["numbers"]}
    assert len(rows) == 2 * 2 * 6  # scales x metrics x methods
    for row in rows:
        entry = found[f"association.{row['scale']}.{row['level']}.{row['metric']}.{row['method']}"]
        for key in ("value", "low", "high"):
            assert float(row[key]) == pytest.approx(entry[key], rel=1e-9)
        narrow = found[f"{entry['name']}.participants_only"]
        assert (float(row["participants_low"]), float(row["participants_high"])) == pytest.approx(
            (narrow["low"], narrow["high"]), rel=1e-9
        )


def draw_nothing() -> Figure:
    raise ValueError("cannot be drawn")


def test_what_the_second_process_cannot_draw_is_drawn_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("feel321.analysis.report.folder.BACKGROUND", True)
    drawing = partial(draw_discrimination, {"x": discriminate(18, 24)})
    pictures = [
        Picture("a", "A.", drawing),
        Picture("b", "B.", lambda: draw_discrimination({"y": discriminate(9, 24)})),
    ]
    content = {"files": list_files(["a", "b"], [])}
    for name, artist in (("healthy", folder._ARTIST), ("ill", "raise SystemExit(1)")):
        monkeypatch.setattr(folder, "_ARTIST", artist)
        with ResultsFolder(tmp_path / name, background=True) as target:
            target.draw(pictures)
            target.write(content, page="".join, tables={})
        assert sorted(file.name for file in (tmp_path / name).rglob("*.png")) == ["a.png", "b.png"]
    with ResultsFolder(tmp_path / "c", background=True) as target:
        target.draw([Picture("c", "C.", draw_nothing)])
        with pytest.raises(ValueError, match="cannot be drawn"):
            target.write({"files": []}, page="".join, tables={})
    assert not (tmp_path / "c").exists()
