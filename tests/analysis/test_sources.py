"""Recordings made from one another: models that know of it hold their level, and copies add no certainty."""

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom

from feel321.analysis.primary.model import fit_primary
from feel321.analysis.primary.plan import make_cells
from feel321.analysis.primary.sensitivity import leave_out_units
from feel321.analysis.report import means
from feel321.analysis.resampling import Choices
from feel321.analysis.table.reading import read_table

METRICS = ["sm", "tm"]
STUDIES = 400
PLAIN = (
    "rating ~ 1 + sm_w + tm_w + sm_b + tm_b + (1 + sm_w + tm_w || participant) + (1 | recording) + (1 | item)"
    " + (1 | participant:recording)"
)
SHARED = " + (1 + sm_w + tm_w || source) + (1 | source:reducer)"
REDUCERS = " + (1 | reducer) + (1 | participant:reducer)"


def make_rows(
    seed: int,
    *,
    people: int = 8,
    sources: int = 5,
    turns: int = 3,
    reducers: int = 5,
    source_slope: float = 0.0,
) -> pd.DataFrame:
    """A study of turned recordings: nothing to be found, and much that is felt alike however a source is turned."""
    rng = np.random.default_rng([seed, 9])
    scenes, n = sources * turns, sources * turns * reducers
    source, scene = (
        np.repeat(np.arange(sources), turns * reducers),
        np.repeat(np.arange(scenes), reducers),
    )
    reducer = np.tile(np.arange(reducers), scenes)
    alike = source * reducers + reducer
    metrics = rng.normal(0, 0.15, (2, sources * reducers))[:, alike] + rng.normal(0, 0.06, (2, n))
    metrics += (
        rng.normal(0, 0.1, (2, sources))[:, source] + rng.normal(0, 0.05, (2, scenes))[:, scene]
    )
    felt = 50 + rng.normal(0, 5, sources)[source] + rng.normal(0, 2, scenes)[scene]
    felt = felt + rng.normal(0, 3, sources * reducers)[alike] + rng.normal(0, 1.5, n)
    slopes = np.random.default_rng([seed, 10]).normal(0, source_slope, (2, sources))
    felt = felt + (slopes[:, source] * metrics).sum(axis=0)
    own = rng.normal(0, 8, people)[:, None] + rng.normal(0, 6, (people, 2)) @ metrics
    own += (
        rng.normal(0, 2, (people, scenes))[:, scene]
        + rng.normal(0, 2, (people, sources))[:, source]
    )
    own += rng.normal(0, 3, (people, sources * reducers))[:, alike]
    rating = felt + own + rng.normal(0, 5, own.shape)
    who, item = (axis.ravel() for axis in np.indices(rating.shape))
    return pd.DataFrame({
        "participant": who, "item": item, "recording": scene[item], "source": source[item], "reducer": reducer[item],
        "sm": metrics[0, item], "tm": metrics[1, item], "rating": rating.ravel(),
    })  # fmt: skip


@pytest.fixture(scope="module")
def rows() -> pd.DataFrame:
    return make_rows(0)


def test_the_model_holds_what_recordings_of_a_source_share(rows: pd.DataFrame) -> None:
    model = fit_primary(rows, METRICS)
    assert model.formula == PLAIN + SHARED + REDUCERS
    assert (model.n_recordings, model.n_sources) == (15, 5)
    assert model.reductions == ()
    few = fit_primary(rows[rows["source"] < 4], METRICS)
    assert any(note.startswith("4 sources of recordings only") for note in few.notes)


def test_without_shared_sources_nothing_changes(rows: pd.DataFrame) -> None:
    plain = fit_primary(rows.drop(columns="source"), METRICS)
    assert plain.formula == PLAIN.replace("(1 | rec", "(1 + sm_w + tm_w || rec") + REDUCERS
    assert plain.n_sources == plain.n_recordings == 15
    for alone in (rows["recording"] + 100, None, ""):
        model = fit_primary(rows.assign(source=alone), METRICS)
        pd.testing.assert_frame_equal(model.slopes, plain.slopes, check_exact=True)
        assert (model.formula, model.notes) == (plain.formula, plain.notes)


def test_one_source_speaks_of_no_other(rows: pd.DataFrame) -> None:
    model = fit_primary(rows[rows["source"] == 2], METRICS)
    assert "| source)" not in model.formula
    assert model.formula.endswith(" + (1 | source:reducer) + (1 | participant:reducer)")
    assert not model.slopes["estimable"].any()
    assert (
        "No spread between sources: all recordings come from one; nothing here speaks of others."
        in model.reductions
    )
    assert "No slopes between recordings: with 1 source, 2" in " ".join(model.reductions)


def test_reducers_of_their_own_in_every_recording_need_no_term(rows: pd.DataFrame) -> None:
    other = rows.assign(reducer=rows["reducer"] + 10 * rows["recording"])
    assert fit_primary(other, METRICS).formula == PLAIN + " + (1 + sm_w + tm_w || source)"


def test_sources_are_left_out_whole(rows: pd.DataFrame) -> None:
    small = rows[(rows["source"] < 3) & (rows["reducer"] < 3) & (rows["participant"] < 5)]
    units = [(column, name) for column in ("source", "reducer") for name in range(3)]
    assert list(leave_out_units(make_cells(small, METRICS))) == units


def copy_files(files: Callable[..., object], **design: object) -> tuple[object, dict[str, str]]:
    """Write a study in which every recording occurs three times, rated the same."""
    study = files(participants=6, recordings=4, scales=("realism",), anchors=False, **design)
    for path in (study.ratings, study.manifest):
        table = pd.read_csv(path, dtype=str)
        copies = [
            table.assign(**{
                name: table[name] + f"-r{turn}" for name in ("recording", "stimulus_id")
            })
            for turn in range(3)
        ]
        copied = pd.concat(copies, ignore_index=True)
        if "trial" in copied:
            copied["trial"] = copied.groupby("participant").cumcount() + 1
        copied.to_csv(path, index=False)
    return study, {
        f"rec{number}-r{turn}": f"rec{number}" for number in range(4) for turn in range(3)
    }


@pytest.mark.parametrize(
    ("compute", "design"),
    [
        (means.compute_contrasts, {}),
        (means.compute_levels, {"levels": ("as_is", "equal_intensity")}),
    ],
)
def test_copies_add_no_certainty_to_what_is_said_of_reducers_and_levels(
    files: Callable[..., object], compute: Callable[..., object], design: dict[str, object]
) -> None:
    def measure(study: object, sources: dict[str, str] | None) -> np.ndarray:
        table = read_table(study.ratings, study.manifest, sources=sources)
        found, *_ = compute(table, Choices()).rows.values()
        rows = [row for row in found if row["quantity"] == "difference"]
        t = [row["value"] for row in found if row["quantity"] == "t"]
        return np.array([row["value"] for row in rows]) / np.array(t)

    one = measure(
        files(participants=6, recordings=4, scales=("realism",), anchors=False, **design), None
    )
    study, sources = copy_files(files, **design)
    known, believed = measure(study, sources), measure(study, None)
    assert np.median(known / one) == pytest.approx(1, abs=0.15)
    assert (believed / one).min() < 0.75


@pytest.mark.soak
def test_the_primary_test_holds_its_level_where_recordings_are_turned() -> None:
    """400 studies of 8 people, 5 sources turned to three recordings each, 5 reducers: 4-7 % false positives.

    Sources differ in their slopes by 10 points per unit (SD): a model that estimates such a spread is too careful where
    there is none.
    """
    tables = [
        fit_primary(make_rows(seed, source_slope=10.0), METRICS).slopes["p"]
        for seed in range(STUDIES)
    ]
    share = np.mean(np.array(tables) < 0.05, axis=0)
    print(f"false positives, sm and tm: {share}")  # noqa: T201 - the figure
    least, most = binom.ppf([0.025, 0.975], 2 * STUDIES, [0.04, 0.07]) / (2 * STUDIES)
    assert least <= share.mean() <= most
