"""Data for R and JASP: plain columns, and models whose slopes are those of feel321."""

import csv
import re
import shutil
import subprocess
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from feel321 import analysis
from feel321.analysis import export
from feel321.analysis.primary.rcode import RESERVED, make_r_name, rename_terms, write_r_string

PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_]*")

WITH_R = {
    # R 4.2.2, lme4 1.1-31, lmerTest 3.1-3: estimate, se, df.
    ("realism", "spectral_match_step"): (2.912356590552, 0.25917838195192, 215.9128),
    ("realism", "my_metric_step"): (0.653098882129535, 0.112201020050374, 219.9951),
    ("force", "spectral_match_step"): (3.21175791923021, 0.306562448857273, None),
    ("force", "my_metric_step"): (0.599590769703655, 0.14608981090784, None),
}
"""Slopes by R: realism has 9 reducers; force has 5, repeated, and so the penalty on their spread."""


@pytest.fixture(scope="module")
def table() -> analysis.Table:
    """Two scales: one rating per stimulus of 9 reducers; two of each of 5 reducers."""
    rng = np.random.default_rng(321)
    who, recordings, reducers = range(8), "abcd", [f"my321_{number}" for number in range(9)]
    stimuli = pd.DataFrame(
        [(f"{r}-{m}", r, m) for r, m in product(recordings, reducers)],
        columns=["stimulus_id", "recording", "reducer"],
    ).assign(level="as_is", role="test")
    stimuli["spectral_match"] = rng.uniform(0, 1, len(stimuli)).round(3)
    stimuli["my-metric"] = rng.uniform(-1, 1, len(stimuli)).round(3)
    oddness = rng.normal(0, 4, (len(reducers),))
    mood, taste = rng.normal(0, 8, len(who)), rng.normal(0, 8, (len(who), len(stimuli)))
    rows = []
    for scale, some, times in (("realism", 9, 1), ("force", 5, 2)):
        for person, place, again in product(who, range(len(stimuli)), range(times)):
            number = place % 9
            if number < some:
                good = 30 * stimuli["spectral_match"][place] + 6 * stimuli["my-metric"][place]
                rating = 45 + good + oddness[number] + mood[person] + taste[person, place]
                rating += rng.normal(0, 5)
                name = stimuli["stimulus_id"][place]
                rows.append((
                    f"00{person}",
                    name,
                    scale,
                    again + 1,
                    min(max(round(rating), 0), 100),
                ))
    columns = ["participant", "stimulus_id", "scale", "repeat", "rating"]
    ratings = pd.DataFrame(rows, columns=columns)
    return analysis.read_table(ratings, stimuli, metrics=["spectral_match", "my-metric"])


@pytest.fixture(scope="module")
def folder(table: analysis.Table, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export.export_r(table, tmp_path_factory.mktemp("export") / "for r")


def test_every_file_is_plain(folder: Path) -> None:
    for path in {*folder.glob("*.csv")} - {folder / "dictionary.csv"}:  # which holds sentences
        raw = path.read_bytes()
        assert raw.isascii()
        assert b"\r" not in raw
        assert b'"' not in raw
        head, *rows = csv.reader(raw.decode().splitlines())
        assert all(PLAIN.fullmatch(name) and name not in RESERVED for name in head)
        assert len(set(head)) == len(head)
        assert rows
        assert {len(row) for row in rows} == {len(head)}
        cells = {cell for row in rows for cell in row}
        assert not cells & {"", "nan", "None", "True", "False", "true", "false"}


def test_judgements_are_those_of_the_model(table: analysis.Table, folder: Path) -> None:
    rows = pd.read_csv(folder / "judgements.csv", dtype={"participant": str})
    assert list(rows)[:2] == ["participant", "recording"]
    assert len(rows) == len(table.rows)
    assert set(rows["participant"]) == {f"00{number}" for number in range(8)}
    for metric in ("spectral_match", "my_metric"):
        whole = rows[f"{metric}_w"] + rows[f"{metric}_b"]
        np.testing.assert_allclose(whole, rows[metric], atol=1e-9)
        items = rows.drop_duplicates(["scale", "stimulus"])
        within = items.groupby(["scale", "recording"])[f"{metric}_w"].sum()
        np.testing.assert_allclose(within, 0, atol=1e-9)


def test_slopes_are_those_of_fit_primary(table: analysis.Table, folder: Path) -> None:
    listed = pd.read_csv(folder / "slopes.csv").set_index(["scale", "metric"])
    for scale in ("realism", "force"):
        own = analysis.fit_primary(table, scale=scale, explain=False).slopes
        for metric, name in (("spectral_match", "spectral_match"), ("my-metric", "my_metric")):
            step = listed.loc[(scale, name), "step"]
            assert listed.loc[(scale, name), "estimate"] == pytest.approx(
                own["estimate"][metric] * step
            )


@pytest.mark.parametrize(("scale", "term"), WITH_R)
def test_slopes_agree_with_lme4(folder: Path, scale: str, term: str) -> None:
    """R fitted the script's models on the script's data before recordings had slopes of their own."""
    formulas = re.findall(
        r"lmer\w*\((rating ~ .*?), (?:data = )?part", (folder / "model.R").read_text()
    )
    slopes = "(1 + spectral_match_step + my_metric_step || recording)"
    formula = formulas[("realism", "force").index(scale)]
    assert slopes in formula
    part = pd.read_csv(folder / "judgements.csv").query("scale == @scale")
    mean = part.groupby(["participant", "stimulus"])["rating"].transform("mean")
    part = part.assign(rating=mean, item=part["stimulus"]).drop_duplicates(["participant", "item"])
    held = ["reducer"] if scale == "force" else []
    fit = analysis.fit_mixed(formula.replace(slopes, "(1 | recording)"), part, penalty=held)
    listed, (estimate, se, df) = fit.fixed.loc[term], WITH_R[scale, term]
    assert listed["estimate"] == pytest.approx(estimate, abs=1e-4 * se)
    assert listed["se"] == pytest.approx(se, rel=1e-4)
    if df:
        assert listed["df"] == pytest.approx(df, rel=1e-3)


@pytest.mark.soak
def test_r_runs_the_script(folder: Path) -> None:
    r = shutil.which("Rscript")
    if (
        r is None
        or subprocess.run([r, "-e", "library(lme4)"], capture_output=True, check=False).returncode
    ):
        pytest.skip("R with lme4 is missing here: model.R is not run")
    done = subprocess.run([r, "model.R"], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    by_r, own = (pd.read_csv(folder / name) for name in ("slopes_r.csv", "slopes.csv"))
    (folder / "slopes_r.csv").unlink()
    assert list(by_r["term"]) == list(own["term"])
    np.testing.assert_allclose(by_r["estimate"], own["estimate"], atol=1e-3 * own["se"].min())
    np.testing.assert_allclose(by_r["se"], own["se"], rtol=1e-3)


def test_only_an_earlier_export_is_replaced(table: analysis.Table, tmp_path: Path) -> None:
    rows = table.rows[table.rows["reducer"] == "my321_0"]
    some = analysis.Table(rows, table.metrics, ())
    place = export.export_r(some, tmp_path / "for-r")
    (place / "slopes_r.csv").touch()
    (place / "my.R").write_text("mine")
    export.export_r(some, place)
    assert (place / "my.R").read_text() == "mine"
    assert not (place / "slopes_r.csv").exists()
    other = tmp_path / "other"
    other.mkdir()
    (other / "model.R").write_text("mine")
    for path in (other, other / "model.R"):
        with pytest.raises(FileExistsError, match="holds files that are not"):
            export.export_r(some, path)
    assert [path.read_text() for path in other.iterdir()] == ["mine"]


def test_names_and_text_are_such_as_r_takes() -> None:
    names = (make_r_name("repeat"), make_r_name("my-metric"), make_r_name("2nd", {"x2nd"}))
    assert names == ("repeat_", "my_metric", "x2nd_2")
    assert write_r_string('r\u00e9alisme "1"') == '"r\\u00e9alisme \\"1\\""'
    formula = "rating ~ 1 + `my-m_w` + (1 | item)"
    renamed = rename_terms(formula, {"my-m_w": "my_m", "item": "stimulus"})
    assert renamed == "rating ~ 1 + my_m + (1 | stimulus)"
