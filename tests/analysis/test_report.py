"""The report as files: pages, tables and `results.json` are one frame, and only its own files are replaced."""

import html
import json
import math
import re
import shutil
import subprocess
from collections.abc import Callable
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from scipy import stats

import feel321.analysis.report.folder
from feel321.analysis import words
from feel321.analysis.figures import inline_svg
from feel321.analysis.report.folder import list_files, write_folder
from feel321.analysis.report.section import find_row, make_row, make_slug
from feel321.analysis.report.write import QUESTIONS, SECTIONS, order_scales, write_report
from feel321.analysis.table.items import Table
from feel321.analysis.words import PLACES, format_number

NUMBER = re.compile(r"(?<![\w.])[−-]?\d+(?:\.\d+)?(?![\w])")
"""A number that stands alone: neither the 321 of dft321 nor a version's parts."""

FIXED = ["value", "low", "high", "p", "n", "interval", "note", "status"]
MOST_WORDS, MOST_NUMBERS, SHEETS = 2500, 600, 2
CHROMIUM = shutil.which("chromium")


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


def load(report: Path) -> dict[str, Any]:
    def refuse(name: str) -> None:
        raise ValueError(f"{name} is no JSON")

    return json.loads((report / "results.json").read_text(encoding="utf-8"), parse_constant=refuse)


def gather_strings(content: object) -> list[str]:
    parts = content.values() if isinstance(content, dict) else content
    if isinstance(content, str) or not isinstance(content, dict | list):
        return [content] if isinstance(content, str) else []
    return [text for part in parts for text in gather_strings(part)]


def gather_numbers(results: dict[str, Any]) -> set[str]:
    """List every number of the results in every way that it may be written."""
    rows = results["numbers"]
    values = {row[key] for row in rows for key in ("value", "low", "high", "p")} - {None}
    values |= {100 * value for value in values} | {abs(value) for value in values}
    return {
        word
        for value in values
        for kind in PLACES
        for word in NUMBER.findall(format_number(value, kind=kind))
    }


def test_pages_show_no_number_that_is_not_in_the_results(report: Path) -> None:
    results = load(report)
    spoken = [results[key] for key in ("how", "figures", "captions", "notes", "inputs", "versions")]
    told = [row["note"] for row in results["numbers"]]
    allowed = gather_numbers(results) | set(
        NUMBER.findall(" ".join(gather_strings([spoken, told])))
    )
    allowed |= {"95", "90", "0.1", "80", "1"}  # intervals, steps, power, eq. 1
    for name, least in (("index.html", 40), ("details.html", 300)):
        shown = set(NUMBER.findall(" ".join(Page(report / name).words)))
        assert len(shown) > least
        rules = set(NUMBER.findall(" ".join(results["answers"]["raters"])))
        assert shown - allowed - rules == set()


def test_the_first_page_is_short(report: Path) -> None:
    text = " ".join(Page(report / "index.html").words)
    assert len(text.split()) <= MOST_WORDS
    assert len(NUMBER.findall(text)) <= MOST_NUMBERS


@pytest.mark.skipif(not CHROMIUM, reason="PAGE NOT PRINTED: chromium is not installed")
def test_the_first_page_prints_on_two_sheets(report: Path, tmp_path: Path) -> None:
    printed = tmp_path / "index.pdf"
    command = [
        CHROMIUM,
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        "--no-pdf-header-footer",
    ]
    command += [f"--user-data-dir={tmp_path}", f"--print-to-pdf={printed}"]
    page = (report / "index.html").as_uri()
    subprocess.run([*command, page], capture_output=True, timeout=120, check=True)
    assert len(re.findall(rb"/Type\s*/Page\b(?!s)", printed.read_bytes())) <= SHEETS


WRITTEN = [
    (words.format_name("spectral_match_bounded_delivered"), "bounded spectral match delivered"),
    (words.format_name("mushra"), "MUSHRA"), (words.format_method("within_kendall"), "Kendall within recordings"),
    (words.format_note("as_is: 'mine_w' is odd.", ["as_is", "mine"]), "as is: mine within recordings is odd."),
    (words.keep_together("95 % interval"), "95\xa0% interval"),
    (words.join_words(["a", "b", "c"]), "a, b and c"), (words.name_some(list("abcde")), "a, b, c and 2 more"),
    (words.format_count(1, "participant"), "1 participant"), (words.format_span([6, 4, 5]), "4–6"),
    (format_number(-0.256), "−0.26"), (format_number(-0.001), "0.00"), (format_number(-1e200), "−1.0e+200"),
    (words.format_interval(-0.1, 0.734), "−0.10 to 0.73"), (words.format_interval(math.nan, 1.0), "–"),
    (words.format_estimate(2e-4, -1e-3, 2e-3), ("2.0e−04", "−1.0e−03 to 2.0e−03")),
    (words.format_p(0.0123), "p = 0.012"), (words.format_p(1e-9), "p <\xa00.001"),
]  # fmt: skip


@pytest.mark.parametrize(("written", "wanted"), WRITTEN)
def test_how_names_and_numbers_are_written(written: object, wanted: object) -> None:
    assert written == wanted


def test_a_row_is_one_number_and_says_what_it_is(report: Path) -> None:
    seen = set()
    for row in load(report)["numbers"]:
        assert list(row)[:2] == ["table", "quantity"]
        assert list(row)[-len(FIXED) :] == FIXED
        key = tuple((name, value) for name, value in row.items() if name not in FIXED)
        assert key not in seen
        seen.add(key)
        assert row["status"] == "exploratory"  # nothing was frozen
        assert bool(row["interval"]) == (row["low"] is not None)
        if row["low"] is not None and row["value"] is not None:
            assert row["low"] <= row["value"] + 1e-9
            assert row["value"] <= row["high"] + 1e-9


def test_tables_are_the_rows_of_the_results(report: Path) -> None:
    numbers = load(report)["numbers"]
    for name in dict.fromkeys(row["table"] for row in numbers):
        own = [row for row in numbers if row["table"] == name]
        frame = pd.read_csv(report / "tables" / f"{name}.csv", keep_default_na=False)
        assert list(frame["quantity"]) == [row["quantity"] for row in own]
        values = pd.to_numeric(frame["value"]).tolist()
        wanted = [math.nan if row["value"] is None else row["value"] for row in own]
        assert values == pytest.approx(wanted, nan_ok=True, rel=1e-9)
        assert set(frame) >= set(own[0]) - {"table"}
    described = pd.read_csv(report / "tables" / "dictionary.csv")
    pairs = {(f"{row['table']}.csv", row["quantity"]) for row in numbers}
    assert pairs <= set(zip(described["file"], described["quantity"], strict=True))
    assert described["meaning"].notna().all()
    told = described.set_index(["file", "quantity"])["meaning"]
    assert told["contrasts.csv", "difference"].endswith("; p by Holm")
    assert told["slopes.csv", "slope"].count("Holm") == 1
    assert "p of differences adjusted by Holm" in " ".join(load(report)["how"])


def test_numbers_are_those_of_the_files(report: Path, study: object) -> None:
    manifest = pd.read_csv(study.manifest, index_col="stimulus_id")
    manifest = manifest[manifest["role"] == "test"]
    ratings = pd.read_csv(study.ratings).query("scale == 'similarity'")
    means = ratings.groupby("stimulus_id")["rating"].mean()[manifest.index]
    numbers = load(report)["numbers"]
    keys = {"scale": "similarity", "metric": "temporal_match", "method": "Spearman"}
    r = find_row(numbers, "r", table="associations", **keys)["value"]
    assert r == pytest.approx(stats.spearmanr(means, manifest["temporal_match"]).statistic)
    one = find_row(
        numbers, "mean", table="stimuli", scale="similarity", stimulus="rec0_dft321_as_is"
    )
    assert one["value"] == pytest.approx(means["rec0_dft321_as_is"])
    assert find_row(numbers, "n_judgements")["value"] == 1152


def check(  # noqa: C901 - one branch for each word of JSON Schema that is used
    value: object, schema: dict[str, Any], whole: dict[str, Any], place: str = "$"
) -> list[str]:
    """Hold a value against the parts of JSON Schema that results.schema.json uses."""
    if "$ref" in schema:
        schema = whole["$defs"][schema["$ref"].rpartition("/")[2]] | {
            key: one for key, one in schema.items() if key != "$ref"
        }
    for part in schema.get("allOf", ()):
        if wrong := check(value, part, whole, place):
            return wrong
    kinds = {
        "object": dict, "array": list, "string": str, "boolean": bool, "integer": int, "null": type(None),
        "number": (int, float),
    }  # fmt: skip
    wanted = schema.get("type", [])
    names = [wanted] if isinstance(wanted, str) else wanted
    if names and not any(isinstance(value, kinds[name]) for name in names):
        return [f"{place}: {value!r} is not {wanted}"]
    if value not in schema.get("enum", [value]) or value != schema.get("const", value):
        return [f"{place}: {value!r}"]
    if isinstance(value, list):
        every = (
            check(one, schema.get("items", {}), whole, f"{place}[{n}]")
            for n, one in enumerate(value)
        )
        return [told for one in every for told in one]
    if not isinstance(value, dict):
        return []
    known, others = schema.get("properties", {}), schema.get("additionalProperties", {})
    wrong = [f"{place}: lacks {name}" for name in schema.get("required", []) if name not in value]
    for name, one in value.items():
        if name in known or others is not False:
            wrong += check(one, known.get(name, others), whole, f"{place}.{name}")
        else:
            wrong.append(f"{place}: has {name}")
    return wrong


def test_results_follow_their_schema(report: Path) -> None:
    folder = Path(feel321.analysis.report.folder.__file__).parent
    schema = json.loads((folder / "results.schema.json").read_text(encoding="utf-8"))
    results = load(report)
    assert check(results, schema, schema) == []
    assert check(results | {"schema_version": 1}, schema, schema)
    assert check(results | {"more": 1}, schema, schema)
    results["verdicts"][0]["verdict"] = "undecided"
    assert check(results, schema, schema) == ["$.verdicts[0].verdict: 'undecided'"]


def test_the_same_seed_gives_the_same_bytes(report: Path, study: object, tmp_path: Path) -> None:
    write_report(study.ratings, study.manifest, tmp_path / "again", draws=50, rng=3)
    paths = [path.relative_to(report) for path in sorted(report.rglob("*")) if path.is_file()]
    assert {path.as_posix() for path in paths} == set(load(report)["files"])
    for path in paths:
        assert (report / path).read_bytes() == (tmp_path / "again" / path).read_bytes(), path


@pytest.mark.parametrize("name", ["index.html", "details.html"])
def test_pages_read_well_without_eyes(report: Path, name: str) -> None:
    page, results = Page(report / name), load(report)
    text = (report / name).read_text(encoding="utf-8")
    namespaces = {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}
    assert set(re.findall(r"https?://[^\s\"'<>]+", text)) <= namespaces
    assert not page.find("script")
    assert page.find("html")[0]["lang"] == "en"
    assert len(page.ids) == len(set(page.ids))
    assert all(svg["role"] == "img" and svg["aria-label"] for svg in page.find("svg"))
    assert all(image["alt"] for image in page.find("img"))
    assert len(page.find("table")) == len(page.find("caption"))
    assert all(cell.get("scope") for cell in page.find("th"))
    assert '<th scope="row"></th>' not in text
    levels = [int(tag[1]) for tag, _ in page.tags if tag in {"h1", "h2", "h3", "h4"}]
    assert levels.count(1) == 1 == levels[0]
    assert all(below <= above + 1 for above, below in pairwise(levels))
    others = {one: Page(report / one).ids for one in ("index.html", "details.html")}
    for link in page.find("a"):
        file, _, anchor = link["href"].partition("#")
        assert not file or (report / file).is_file()
        assert not anchor or anchor in others[file or name]
    assert (
        re.findall(r"\d\s*[ \n]\s*%", re.sub(r"<(svg|style).*?</\1>", "", text, flags=re.DOTALL))
        == []
    )
    assert html.escape(results["headline"], quote=False) in text


def test_details_hold_every_sentence_table_and_figure(report: Path) -> None:
    results = load(report)
    text = html.unescape((report / "details.html").read_text(encoding="utf-8"))
    for lines in results["answers"].values():
        assert all(line in text for line in lines)
    assert all(f"tables/{name}.csv" in text for name in results["captions"])
    assert all(f"figures/{name}.svg" in text for name in results["figures"])
    assert all(
        caption in text.replace("\N{NO-BREAK SPACE}", " ")
        for caption in results["captions"].values()
    )


def test_every_section_answers_a_question_and_has_its_english() -> None:
    assert len({section.key for section in SECTIONS}) == len(SECTIONS)
    assert {section.question for section in SECTIONS} == set(QUESTIONS) - {"paper", "computed"}
    names = [name for section in SECTIONS for name in section.tables]
    assert len(names) == len(set(names))
    assert all(
        quantity.kind in {*PLACES, "note"}
        for one in SECTIONS
        for form in one.tables.values()
        for quantity in form.quantities
    )


def test_names_of_figures_are_told_apart_on_any_file_system() -> None:
    names = ("realism", "Wie echt?", "Wie echt!", "A" * 50, "A" * 51, "mushra", "a-b", "A-b")
    slugs = [make_slug("scatter", name, "as_is") for name in names]
    assert len({slug.casefold() for slug in slugs}) == len(names)
    assert slugs[0] == "scatter_realism_as_is"


def test_a_drawing_takes_the_colours_of_its_page(report: Path) -> None:
    for file in sorted((report / "figures").glob("*.svg")):
        text = file.read_text(encoding="utf-8")
        assert "<text" in text  # words stay words
        inline = str(inline_svg(file.stem, "a < b", file))
        assert 'aria-label="a &lt; b"' in inline
        assert not re.search("#000000|#ffffff|<style", inline)
        ids = re.findall(r'\bid="([^"]*)"', inline)
        assert all(one.startswith(f"{file.stem}-") for one in ids)
        assert set(re.findall(r'(?:href="|url\()#([^")]*)', inline)) <= set(ids)


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize(
    "scales",
    [
        ("粗さ", "硬さ"), ("very rough", "very-rough"), ("Realism", "realism"), ("x" * 300, "x" * 300 + "y"),
    ],
)  # fmt: skip
def test_any_names_of_scales_make_a_report(
    files: Callable[..., object], tmp_path: Path, scales: tuple[str, ...]
) -> None:
    study = files(scales=scales, recordings=3, anchors=False)
    results = write_report(study.ratings, study.manifest, tmp_path / "report", draws=20, rng=0)
    found = results.numbers[results.numbers["table"] == "profiles"]
    assert set(found["scale"]) == set(scales)
    unknown = [note for note in results.notes if "font has no" in note]
    assert len(unknown) == (scales[0] == "粗さ")
    assert all("さ 硬 粗" in note for note in unknown)


@pytest.mark.usefixtures("short")
def test_two_numbers_of_one_name_are_refused(
    study: object, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    twice = [make_row("n_judgements", 1), make_row("n_judgements", 2)]
    monkeypatch.setattr("feel321.analysis.report.write.count_table", lambda _: twice)
    with pytest.raises(ValueError, match="results: 1 rows have the same keys, first"):
        write_report(study.ratings, study.manifest, tmp_path / "report", draws=5, rng=0)


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize("simulated", [True, False])
def test_simulated_ratings_carry_a_banner(
    files: Callable[..., object], tmp_path: Path, simulated: bool
) -> None:
    study = files(simulated=simulated, scales=("realism",))
    results = write_report(study.ratings, study.manifest, tmp_path / "report", draws=20, rng=0)
    for name in ("index.html", "details.html"):
        text = (tmp_path / "report" / name).read_text(encoding="utf-8")
        assert ("Simulated ratings" in text) == simulated == results.simulated
    assert "<time" not in text  # no day is known of tables from elsewhere


def test_a_reduced_analysis_is_a_report_too(files: Callable[..., object], tmp_path: Path) -> None:
    study = files(participants=1, recordings=1, scales=("realism",), anchors=False)
    results = write_report(study.ratings, study.manifest, tmp_path / "report", draws=20, rng=0)
    assert any("One participant only" in note for note in results.notes)
    assert results.numbers.query("table == 'associations'")["low"].isna().all()
    assert '"low": null' in (tmp_path / "report" / "results.json").read_text(encoding="utf-8")
    for name in ("index.html", "details.html"):
        text = (tmp_path / "report" / name).read_text(encoding="utf-8")
        assert "nan" not in re.sub(r"<svg.*?</svg>", "", text, flags=re.DOTALL).replace(
            "explanation", ""
        )


@pytest.mark.usefixtures("short")
def test_ratings_that_no_metric_predicts_are_a_report_too(
    files: Callable[..., object], tmp_path: Path
) -> None:
    study = files(scales=("abx",), anchors=False)
    ratings = pd.read_csv(study.ratings)
    ratings["rating"] = ratings["rating"].gt(50) * 100
    results = write_report(ratings, study.manifest, tmp_path / "report", draws=20, rng=0)
    assert results.headline.startswith("These ratings do not show whether the metrics predict")
    assert list(results.figures) == ["profile"]


@pytest.mark.usefixtures("short")
def test_names_cannot_break_the_page(files: Callable[..., object], tmp_path: Path) -> None:
    study = files(scales=("<script>alert(1)</script>--><b>",), anchors=False)
    write_report(study.ratings, study.manifest, tmp_path / "report", draws=20, rng=0)
    assert not Page(tmp_path / "report" / "index.html").find("script")
    assert not Page(tmp_path / "report" / "details.html").find("b")


@pytest.mark.usefixtures("short")
def test_an_old_report_is_replaced_and_other_files_stay(
    report: Path, study: object, tmp_path: Path
) -> None:
    own = Path(shutil.copytree(report, tmp_path / "report"))
    for name in ("notes.txt", "figures/photo.png", "tables/mine.csv"):
        (own / name).write_text("mine", encoding="utf-8")
    for _ in range(2):
        write_report(study.ratings, study.manifest, own, draws=5, rng=0)
        assert not list((own / "figures").glob("slopes*"))
        for name in ("notes.txt", "figures/photo.png", "tables/mine.csv"):
            assert (own / name).read_text(encoding="utf-8") == "mine"


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
    with pytest.raises(FileExistsError, match="is not of a former report; move it away"):
        write_report(study.ratings, study.manifest, page.parent, draws=5, rng=0)
    assert page.read_text(encoding="utf-8") == "mine"
    assert (tmp_path / "precious.csv").exists()


def test_an_interrupted_report_leaves_the_former_one(report: Path, tmp_path: Path) -> None:
    own = Path(shutil.copytree(report, tmp_path / "report"))
    before = {path: path.read_bytes() for path in own.rglob("*") if path.is_file()}

    def fail(_drawings: object) -> str:
        raise KeyboardInterrupt

    content = {"files": list_files([], ["rows"])}
    with pytest.raises(KeyboardInterrupt):
        write_folder(own, content, page=fail, tables={"rows": pd.DataFrame({"r": [0.5]})})
    assert {path: path.read_bytes() for path in own.rglob("*") if path.is_file()} == before
    assert list(tmp_path.iterdir()) == [own]


def test_scales_come_in_the_order_of_the_study() -> None:
    rows = pd.DataFrame({"protocol": list("bbaac"), "scale": list("BBAAC"), "rating": range(5)})
    table = Table(rows, (), ())
    found = order_scales(table, ("a", "b"))
    assert list(found.rows["scale"]) == list("AABBC")
    assert list(found.rows["rating"]) == [2, 3, 0, 1, 4]
    assert order_scales(table, ("b", "a")).rows.equals(table.rows)
    assert order_scales(table, ()) is table
