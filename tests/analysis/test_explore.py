"""The page's script, in a browser: what it computes is what Python computes."""

from __future__ import annotations

import csv
import html
import json
import re
import shutil
import subprocess
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.association.correlate import make_panel
from feel321.analysis.report.explore import write_points
from feel321.analysis.table.items import split_tests
from feel321.analysis.words import format_name

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

BROWSER = shutil.which("chromium") or shutil.which("google-chrome") or ""
GONE = {"reducers": "mag321", "recordings": "rec2"}

VISIT = """
const kept = [];
window.Blob = class { constructor(parts) { kept.push(parts.join("")); } };
URL.createObjectURL = () => "#";
URL.revokeObjectURL = () => {};
const put = (id, text) => {
  const own = document.createElement("pre");
  own.id = id;
  own.textContent = text;
  document.body.append(own);
};
const cells = (table, k) => [...table.tBodies[0].rows].map((row) => row.cells[k].textContent.trim());
const first = [...document.querySelectorAll("main table")].find((one) => one.tHead.textContent.includes("Judgements"));
first.parentElement.parentElement.querySelectorAll("button.small").forEach((one) => one.click());
const place = [...first.tHead.rows[0].cells].findIndex((head) => head.textContent.trim() === "Mean");
const turn = first.tHead.rows[0].cells[place];
put("before", JSON.stringify(cells(first, place)));
for (const way of ["up", "down", "again"]) {
  turn.querySelector("button").click();
  put(way, JSON.stringify([turn.getAttribute("aria-sort"), cells(first, place)]));
}
const explored = document.querySelector(".explore");
explored.querySelector("button.small").click();
put("explored", kept.pop());
put("heads", String(explored.querySelectorAll("th button.sort").length));
put("csv", JSON.stringify(kept));
for (const [kind, name] of Object.entries(GONE)) {
  const box = [...document.querySelectorAll(`.explore input[name=${kind}]`)]
    .find((one) => one.parentElement.textContent.trim() === name);
  box.click();
}
const marks = [...document.querySelectorAll("figure use.mark")];
put("stops", String(marks.filter((one) => one.tabIndex === 0).length));
const start = marks.find((one) => one.tabIndex === 0);
start.focus();
const label = document.activeElement.getAttribute("aria-label");
start.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight", bubbles: true, cancelable: true }));
put("moved", JSON.stringify([label, document.activeElement.getAttribute("aria-label")]));
put("told", document.querySelector(".tip").textContent);
"""


@pytest.fixture(scope="module")
def visited(report: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Open the page of the report, sort, download, leave out and walk; return what is there then."""
    if not BROWSER:
        pytest.skip("SCRIPT NOT RUN: no chromium is installed")
    folder = tmp_path_factory.mktemp("visit")
    text = (report / "index.html").read_text(encoding="utf-8")
    gone = "{" + ", ".join(f"{kind}: '{name}'" for kind, name in GONE.items()) + "}"
    script = f"<script>{{ {VISIT.replace('GONE', gone)} }}</script></body>"
    page = folder / "page.html"
    page.write_text(text.replace("</body>", script), encoding="utf-8")
    command = [
        BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking",
        f"--user-data-dir={folder / 'profile'}", "--dump-dom", page.as_uri(),
    ]  # fmt: skip
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout


@pytest.fixture
def found(visited: str) -> Callable[[str], str]:
    """Read what the visit wrote down."""
    return lambda name: html.unescape(
        re.search(rf'<pre id="{name}">(.*?)</pre>', visited, re.DOTALL)[1]
    )


@pytest.fixture
def means(study: object) -> pd.DataFrame:
    """Compute the mean rating of each test stimulus on each scale, from the files."""
    ratings, manifest = pd.read_csv(study.ratings), pd.read_csv(study.manifest)
    people = ratings.groupby(["scale", "stimulus_id", "participant"])["rating"].mean()
    rows = people.groupby(["scale", "stimulus_id"]).mean().reset_index()
    return rows.merge(manifest[manifest["role"] == "test"], on="stimulus_id")


def fit_within(rows: pd.DataFrame, metric: str) -> float:
    """Fit a slope with an intercept per recording, by numpy's least squares."""
    each = pd.get_dummies(rows["recording"]).to_numpy(float)
    design = np.column_stack([rows[metric], each])
    return float(np.linalg.lstsq(design, rows["rating"], rcond=None)[0][0])


def correlate_within(rows: pd.DataFrame, metric: str) -> float:
    """Average the recordings' correlations over Fisher's z."""
    each = [part[metric].corr(part["rating"]) for _, part in rows.groupby("recording")]
    return float(np.tanh(np.arctanh(each).mean()))


def test_r_and_slope_without_some_are_those_of_python(visited: str, means: pd.DataFrame) -> None:
    table = re.search(r'<details class="explore">.*?</details>', visited, re.DOTALL)[0]
    rows = [
        [re.sub("<.*?>", "", cell).replace("−", "-") for cell in re.findall(r"<t[hd].*?</t[hd]>", row)]
        for row in re.findall(r"<tr>.*?</tr>", table)[1:]
    ]  # fmt: skip
    left = means[
        (means["reducer"] != GONE["reducers"]) & (means["recording"] != GONE["recordings"])
    ]
    assert len(rows) == 2 * 2
    for ratings, metric, *told in rows:
        name = next(one for one in means if format_name(one) == metric)
        expected = []
        for part in (means, left):
            own = part[part["scale"] == ratings]
            expected += [correlate_within(own, name), 0.1 * fit_within(own, name)]
        shown = [told[0], told[2], told[1], told[3]]  # all: r, slope; chosen: r, slope
        np.testing.assert_allclose([*map(float, shown)], expected, atol=0.0051)
        assert int(told[4]) == len(own) == 8 * 3
    assert "Without mag321, rec2." in table


def test_marks_of_what_is_left_out_fade_and_no_others(visited: str, means: pd.DataFrame) -> None:
    labels = re.findall(r'<use[^>]*class="mark out"[^>]*aria-label="([^"]*)"', visited)
    assert {label.split(";")[0] for label in labels} == set(
        means.loc[
            (means["reducer"] == GONE["reducers"]) | (means["recording"] == GONE["recordings"]),
            "stimulus_id",
        ]
    )


def test_a_point_says_what_it_is_and_arrows_go_along_the_metric(
    found: Callable[[str], str], means: pd.DataFrame
) -> None:
    labels, seen = json.loads(found("moved")), []
    for label in labels:
        stimulus, names, rating, metric = label.split("; ")
        chosen = (means["stimulus_id"] == stimulus) & (means["scale"] == rating.split(":")[0])
        (row,) = means[chosen].to_dict("records")
        assert names == f"{row['reducer']}, {row['recording']}"
        assert float(re.search(r": (\S+)", rating)[1]) == pytest.approx(row["rating"], abs=0.051)
        column, value = metric.replace("−", "-").split(": ")
        own = means.loc[means["scale"] == row["scale"], column.replace(" ", "_")]
        assert float(value) == pytest.approx(row[column.replace(" ", "_")], abs=0.00051)
        seen.append((own < row[column.replace(" ", "_")]).sum())
    assert seen == [0, 1]
    assert labels[1].split("; ")[0] in found("told")
    assert found("stops") == "5"  # one per panel: a figure of one, and one of four


def test_a_click_on_a_head_sorts_and_a_third_restores(found: Callable[[str], str]) -> None:
    before = json.loads(found("before"))
    for way, sign, said in (("up", 1, "ascending"), ("down", -1, "descending")):
        told, cells = json.loads(found(way))
        assert told == said
        assert cells == sorted(before, key=lambda cell: sign * float(cell.replace("−", "-")))
    assert json.loads(found("again")) == [None, before]


def test_a_table_is_downloaded_as_it_stands(found: Callable[[str], str]) -> None:
    (text,) = [one for one in json.loads(found("csv")) if "Judgements" in one][:1]
    head, *rows = csv.reader(text.splitlines())
    assert len(set(head)) == len(head)
    assert head[head.index("Mean") + 1] == "Mean, interval"
    assert [row[head.index("Mean")] for row in rows] == json.loads(found("before"))
    assert {len(row) for row in rows} == {len(head)}


def test_what_is_left_is_sorted_and_downloaded_too(found: Callable[[str], str]) -> None:
    head, *rows = csv.reader(found("explored").splitlines())
    assert head[:4] == ["Ratings", "Metric", "r", "r, chosen"]
    assert (len(rows), int(found("heads"))) == (4, len(head))


def test_a_name_may_hold_what_json_writes_for_no_number(tidy: Callable[..., pd.DataFrame]) -> None:
    table = tidy(participants=1).replace({"reducer": {"dft321": "BaNaNa<"}})
    (part,) = split_tests(table)
    panel = make_panel(part.rows, ["spectral_match"], draws=2, rng=np.random.default_rng(0))
    text = write_points([panel], "pearson", {})
    data = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert "BaNaNa<" in data["reducers"]
    assert "<" not in text
    assert data["panels"][0]["points"][0][5] is None  # one participant, no interval
