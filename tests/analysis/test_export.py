"""Data for R and JASP: plain columns, and models whose slopes are those of feel321."""

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

WITH_R = {
    # R 4.2.2, lme4 1.1-31, lmerTest 3.1-3: estimate, se, df.
    ("realism", "spectral_match"): (2.912356590552, 0.25917838195192, 215.9128),
    ("realism", "my-metric"): (0.653098882129535, 0.112201020050374, 219.9951),
    ("force", "spectral_match"): (3.21175791923021, 0.306562448857273, None),
    ("force", "my-metric"): (0.599590769703655, 0.14608981090784, None),
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
                points = min(max(round(rating), 0), 100)
                rows.append((f"00{person}", name, scale, again + 1, points))
    columns = ["participant", "stimulus_id", "scale", "repeat", "rating"]
    ratings = pd.DataFrame(rows, columns=columns)
    return analysis.read_table(ratings, stimuli, metrics=["spectral_match", "my-metric"])


@pytest.fixture(scope="module")
def folder(table: analysis.Table, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export.export_r(table, tmp_path_factory.mktemp("export") / "for r")


def test_judgements_are_those_of_the_table(table: analysis.Table, folder: Path) -> None:
    raw = (folder / "judgements.csv").read_bytes()
    assert b"\r" not in raw
    assert not {b"True", b"False", b"nan"} & set(raw.replace(b"\n", b",").split(b","))
    rows = pd.read_csv(folder / "judgements.csv", dtype={"participant": str})
    assert len(rows) == len(table.rows)
    assert set(rows["participant"]) == {f"00{number}" for number in range(8)}
    described = pd.read_csv(folder / "dictionary.csv")
    assert set(rows) <= set(described.dropna(subset="meaning")["column"])


def test_slopes_are_those_of_fit_primary(table: analysis.Table, folder: Path) -> None:
    for scale in ("realism", "force"):
        listed = pd.read_csv(folder / f"{scale}_as_is" / "slopes.csv").set_index("metric")
        own = analysis.fit_primary(table, scale=scale, explain=False).slopes
        for metric in table.metrics:
            assert listed.loc[metric, "estimate"] == pytest.approx(own["estimate"][metric])


@pytest.mark.parametrize(("scale", "metric"), WITH_R)
def test_slopes_agree_with_lme4(folder: Path, scale: str, metric: str) -> None:
    """R fitted these models on these data before recordings had slopes of their own, per 0.1 of each metric."""
    place = folder / f"{scale}_as_is"
    (formula,) = re.findall(
        r"lmer\w*\((rating ~ .*?), (?:data = )?model", (place / "model.R").read_text()
    )
    (slopes,) = re.findall(r"\(1 \+ [^|]*\|\| recording\)", formula)
    held = ["reducer"] if scale == "force" else []
    data = pd.read_csv(place / "model.csv", dtype={"participant": str})
    fit = analysis.fit_mixed(formula.replace(slopes, "(1 | recording)"), data, penalty=held)
    listed, (estimate, se, df) = fit.fixed.loc[f"{metric}_w"] / 10, WITH_R[scale, metric]
    assert listed["estimate"] == pytest.approx(estimate, abs=1e-4 * se)
    assert listed["se"] == pytest.approx(se, rel=1e-4)
    if df:
        assert listed["df"] * 10 == pytest.approx(df, rel=1e-3)


@pytest.mark.soak
def test_r_runs_the_script(folder: Path) -> None:
    r, known = shutil.which("Rscript"), {"capture_output": True, "text": True}
    if r is None or subprocess.run([r, "-e", "library(lme4)"], check=False, **known).returncode:
        pytest.skip("R with lme4 is missing here: model.R is not run")
    done = subprocess.run([r, "model.R"], cwd=folder, check=False, **known)
    assert done.returncode == 0, done.stderr


def test_only_an_earlier_export_is_replaced(table: analysis.Table, tmp_path: Path) -> None:
    rows = table.rows[table.rows["reducer"] == "my321_0"]
    some = analysis.Table(rows, table.metrics, ())
    place = export.export_r(some, tmp_path / "for-r")
    (place / "my.R").write_text("mine")
    export.export_r(some, place)
    assert (place / "my.R").read_text() == "mine"
    other = tmp_path / "other"
    other.mkdir()
    (other / "model.R").write_text("mine")
    for path in (other, other / "model.R"):
        with pytest.raises(FileExistsError, match="holds files that are not"):
            export.export_r(some, path)
    assert [path.read_text() for path in other.iterdir()] == ["mine"]
