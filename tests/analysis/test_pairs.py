"""Judgements of two stimuli at once: whose they are, what they leave out, and what they may not claim."""

from __future__ import annotations

import json
import math
import re
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.association.correlate import tabulate_correlations
from feel321.analysis.contrasts.compare import profile_reducers
from feel321.analysis.report.answer import find_row
from feel321.analysis.report.section import split_parts
from feel321.analysis.report.write import write_report
from feel321.analysis.table.reading import Table, read_table
from feel321.stimuli.reducers.registry import DEFAULT_REDUCERS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

STIMULI = {"orig": "reference", "mag321": "test", "dft321": "test", "anchor_low": "anchor"}


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., tuple[Path, Path]]:
    """Write judgements (participant, scale, stimulus, reference, rating) of one recording, and its manifest."""

    def save(
        judgements: Sequence[tuple[object, ...]], *, more: dict[str, Sequence[object]] | None = None
    ) -> tuple[Path, Path]:
        names = ["participant", "scale", "stimulus_id", "reference_id", "rating"]
        ratings, manifest = tmp_path / "ratings.csv", tmp_path / "manifest.csv"
        table = pd.DataFrame(judgements, columns=names)
        table.assign(**{"trial": range(1, len(judgements) + 1), **(more or {})}).to_csv(
            ratings, index=False
        )
        rows = [(name, "rec", name, "as_is", role, 0.5, 0.5) for name, role in STIMULI.items()]
        columns = [
            "stimulus_id",
            "recording",
            "reducer",
            "level",
            "role",
            "spectral_match",
            "temporal_match",
        ]
        pd.DataFrame(rows, columns=columns).to_csv(manifest, index=False)
        return ratings, manifest

    return save


def list_judged(table: Table) -> list[tuple[str, str]]:
    return list(zip(table.rows["stimulus_id"], table.rows["role"], strict=True))


PAIRS = [
    ("p", "dissimilarity", "mag321", "orig", 60),
    ("p", "dissimilarity", "orig", "dft321", 20),
    ("p", "dissimilarity", "orig", "orig", 0),
    ("p", "dissimilarity", "dft321", "mag321", 50),
    ("p", "dissimilarity", "dft321", "dft321", 5),
    ("p", "dissimilarity", "anchor_low", "orig", 90),
    ("p", "dissimilarity", "orig", "anchor_low", 80),
    ("p", "dissimilarity", "mag321", "anchor_low", 70),
]


def test_a_dissimilarity_is_about_what_was_compared_with_the_reference(
    write: Callable[..., tuple[Path, Path]],
) -> None:
    table = read_table(*write(PAIRS))
    assert list_judged(table) == [
        ("mag321", "test"),
        ("dft321", "test"),
        ("orig", "reference"),
        ("dft321", "pair"),
        ("dft321", "reference"),
        ("anchor_low", "anchor"),
        ("anchor_low", "anchor"),
        ("mag321", "pair"),
    ]
    assert list(table.rows["reducer"]) == list(table.rows["stimulus_id"])
    assert list(table.rows["rating"]) == [row[-1] for row in PAIRS]


def test_other_scales_keep_their_direction(write: Callable[..., tuple[Path, Path]]) -> None:
    judgements = [
        ("p", "similarity", "orig", "dft321", 80),
        ("p", "similarity", "dft321", "mag321", 30),
    ]
    assert list_judged(read_table(*write(judgements))) == [
        ("orig", "reference"),
        ("dft321", "test"),
    ]


def test_a_reducer_judged_against_itself_is_the_hidden_reference(
    write: Callable[..., tuple[Path, Path]],
) -> None:
    judgements = [("p", "mushra", name, "dft321", 50) for name in STIMULI]
    table = read_table(*write(judgements))
    assert list_judged(table) == list((STIMULI | {"dft321": "reference"}).items())


def test_profiles_leave_out_pairs_of_two_reducers(write: Callable[..., tuple[Path, Path]]) -> None:
    table = read_table(*write([*PAIRS, *(("q", *row[1:]) for row in PAIRS)]))
    profile = profile_reducers(table.rows[table.rows["role"] != "pair"])
    found = {(row["role"], row["reducer"]): row["mean"] for row in profile.to_dict("records")}
    assert found == {
        ("test", "mag321"): 60,
        ("test", "dft321"): 20,
        ("reference", "orig"): 0,
        ("reference", "dft321"): 5,
        ("anchor", "anchor_low"): 85,
    }


def test_without_reference_every_dissimilarity_is_from_the_reference(
    write: Callable[..., tuple[Path, Path]],
) -> None:
    table = read_table(
        *write([("p", "dissimilarity", "mag321", "", 60), ("p", "dissimilarity", "orig", "", 3)])
    )
    assert list_judged(table) == [("mag321", "test"), ("orig", "reference")]
    note = "2 judgements of scale 'dissimilarity' name no reference_id: they are taken as from the reference."
    assert note in table.notes


def test_an_unknown_partner_is_refused(write: Callable[..., tuple[Path, Path]]) -> None:
    message = "ratings.csv, line 3: reference_id must be a stimulus of the manifest, or empty, in"
    with pytest.raises(ValueError, match=message):
        read_table(*write([PAIRS[0], ("p", "dissimilarity", "mag321", "ghost", 60)]))


def test_pairs_are_told_apart_by_both_where_repeats_count(
    write: Callable[..., tuple[Path, Path]],
) -> None:
    judgements = [
        ("p", "dissimilarity", "mag321", "orig", 60),
        ("p", "dissimilarity", "mag321", "dft321", 40),
    ]
    paths = write(judgements)
    frame = pd.read_csv(paths[0]).drop(columns="trial")
    frame.to_csv(paths[0], index=False)
    assert list(read_table(*paths).rows["repeat"]) == ["1", "1"]
    frame.assign(repeat=1).to_csv(paths[0], index=False)
    assert len(read_table(*paths).rows) == 2
    pd.concat([frame, frame]).assign(repeat=1).to_csv(paths[0], index=False)
    with pytest.raises(
        ValueError,
        match=r"ratings.csv, lines 4, 5: repeat must occur once with the same participant, scale,",
    ):
        read_table(*paths)


def test_other_references_than_the_recording_are_noted(
    write: Callable[..., tuple[Path, Path]],
) -> None:
    references = ["surface", "surface", "dft321", "ghost", "orig", ""]
    table = read_table(*write([("p", "similarity", "mag321", name, 40) for name in references]))
    assert [note for note in table.notes if note.startswith("Scale")] == [
        "Scale 'similarity': 2 judgements were made against the real surface; the metrics compare with the recording.",
        "Scale 'similarity': 1 judgements were made against what 'dft321' made of the recording; the metrics compare "
        "with the recording: none enters an association or a slope.",
        "Scale 'similarity': 1 judgements were made against what the manifest does not list; the metrics compare with "
        "the recording.",
    ]


def test_metrics_speak_only_of_what_was_judged_against_its_recording(
    write: Callable[..., tuple[Path, Path]],
) -> None:
    references = ["surface", "dft321", "ghost", "orig", "", "elsewhere"]
    paths = write([("p", "similarity", "mag321", name, 40) for name in references])
    manifest = pd.read_csv(paths[1])
    other = manifest[manifest["stimulus_id"] == "orig"].assign(
        stimulus_id="elsewhere", recording="s"
    )
    pd.concat([manifest, other]).to_csv(paths[1], index=False)
    table = read_table(*paths)
    assert dict(zip(references, table.rows["matched"], strict=True)) == {
        "surface": True,
        "dft321": False,
        "ghost": True,
        "orig": True,
        "": True,
        "elsewhere": False,
    }
    assert any("were made against a stimulus of another recording" in note for note in table.notes)
    assert [len(part.rows) for part in split_parts(table)] == [4]
    assert [len(part.rows) for part in split_parts(table, matched=False)] == [6]


def test_both_stimuli_of_a_pair_count_as_rated(write: Callable[..., tuple[Path, Path]]) -> None:
    notes = read_table(*write([("p", "dissimilarity", "mag321", "dft321", 40)])).notes
    assert "2 of 4 stimuli of the manifest were rated by nobody: 'orig', 'anchor_low'." in notes
    notes = read_table(*write([("p", "similarity", "mag321", "dft321", 40)])).notes
    assert any(
        note.startswith("3 of 4 stimuli of the manifest were rated by nobody") for note in notes
    )


def test_a_bad_attempt_and_the_good_one_share_a_trial(
    write: Callable[..., tuple[Path, Path]],
) -> None:
    page = [("p", "mushra", name, "orig", 50) for name in STIMULI]
    more = {"trial": [1] * 12, "session": [1] * 8 + [2] * 4, "rejected": [True] * 4 + [False] * 8}
    table = read_table(*write([*page, *page, *page], more=more))
    assert len(table.rows) == 8
    assert "4 judgements marked as rejected are left out." in table.notes
    with pytest.raises(
        ValueError,
        match=r"ratings.csv, lines 6, 7, 8 and 1 more: trial must occur once with the same",
    ):
        read_table(*write([*page, *page, *page], more=more | {"rejected": [False] * 12}))


def test_who_has_no_valid_judgement_is_named(write: Callable[..., tuple[Path, Path]]) -> None:
    judgements = [(name, "realism", "mag321", "", 50) for name in ("p", "q", "q", "r")]
    table = read_table(*write(judgements, more={"rejected": [True, True, False, True]}))
    assert "Participants without a valid judgement, who do not count: 'p', 'r'." in table.notes
    assert set(table.rows["participant"]) == {"q"}


def test_no_metric_is_set_against_right_and_wrong(tidy: Callable[..., pd.DataFrame]) -> None:
    rated = tidy()
    whole = Table(pd.concat([rated, tidy(scales=("abx",))]), ("spectral_match",), ())
    found = tabulate_correlations(whole, method="all", draws=20)
    assert set(found["scale"]) == {"realism"}
    assert set(profile_reducers(whole)["scale"]) == {"realism", "abx"}
    alone = tabulate_correlations(rated, ["spectral_match"], method="all", draws=20)
    assert found.equals(alone)


def test_a_dissimilarity_from_the_original_is_a_similarity_turned_round(
    tidy: Callable[..., pd.DataFrame],
) -> None:
    likeness = tidy(scales=("similarity",))
    turned = likeness.assign(scale="dissimilarity", rating=100 - likeness["rating"])
    pairs_too = turned.assign(role=turned["role"].where(turned["role"] != "test", "pair"))
    plain, recast = (
        tabulate_correlations(rows, ["spectral_match"], method="all", draws=20)
        for rows in (likeness, pd.concat([turned, pairs_too]))
    )
    assert set(recast["scale"]) == {"similarity_to_original"}
    assert recast["value"].to_numpy() == pytest.approx(plain["value"].to_numpy())
    assert recast["n_items"].to_list() == plain["n_items"].to_list()
    assert (plain["value"] > 0.3).all()
    frame = Table(turned.assign(source=turned["recording"]), ("spectral_match",), ()).model_frame()
    tested = likeness[likeness["role"] == "test"]
    assert sorted(frame["rating"]) == pytest.approx(sorted(tested["rating"]))


def test_everybody_right_is_no_interval(tidy: Callable[..., pd.DataFrame]) -> None:
    table = tidy(scales=("abx",))
    answers = np.where(table["reducer"] == "dft321", 100.0 * (table["repeat"] == 1), 100.0)
    everyone = profile_reducers(table.assign(rating=answers))
    assert everyone["low"].isna().all()
    missed = (
        (table["reducer"] == "mag321")
        & (table["participant"] == "p01")
        & (table["recording"] == "rec0")
    )
    row = (
        profile_reducers(table.assign(rating=np.where(missed, 0.0, 100.0)))
        .set_index("reducer")
        .loc["mag321"]
    )
    means = np.array([100, 75, 100, 100, 100, 100.0])
    assert row["mean"] == pytest.approx(means.mean())
    assert row["high"] == 100
    assert row["mean"] - row["low"] == pytest.approx(2.570582 * means.std(ddof=1) / math.sqrt(6))


def read_page(folder: Path) -> str:
    return re.sub(
        r"<svg.*?</svg>", "", (folder / "index.html").read_text(encoding="utf-8"), flags=re.DOTALL
    )


@pytest.mark.usefixtures("sketched")
def test_comparisons_alone_are_a_page_without_a_claim(
    files: Callable[..., object], tmp_path: Path
) -> None:
    study = files(scales=("abx",))
    ratings = pd.read_csv(study.ratings)
    ratings["rating"] = np.where(ratings["rating"] > 50, 100.0, 0.0)
    ratings.assign(reference_id=ratings["recording"] + "_original_as_is").to_csv(
        study.ratings, index=False
    )
    results = write_report(study.ratings, study.manifest, tmp_path / "report", draws=20, rng=0)
    assert results.answers["metrics"][0].startswith(
        "These ratings do not show whether the metrics predict what people feel"
    )
    lead = "Scale 'abx': none of its 576 judgements enters an association, because they are right (100) or wrong (0)"
    assert any(note.startswith(lead) for note in results.notes)
    tables = results.numbers["table"]
    assert not tables.isin(["associations", "differences"]).any()
    assert (tables == "profiles").sum() == 12 * 4
    page = read_page(tmp_path / "report")
    assert "bootstrap" not in page
    assert "Guessing gives 50 in ABX." in page
    assert {"tables/participants.csv", "tables/profiles.csv"} <= set(results.files)
    assert not [name for name in results.files if "association" in name or "slope" in name]
    json.loads((tmp_path / "report" / "results.json").read_text(encoding="utf-8"))


@pytest.mark.usefixtures("sketched")
def test_dissimilarities_from_the_original_answer_the_question(
    files: Callable[..., object], tmp_path: Path
) -> None:
    study = files(scales=("dissimilarity",), spectral=40.0)
    ratings = pd.read_csv(study.ratings)
    ratings = ratings.assign(
        reference_id=ratings["recording"] + "_original_as_is", rating=100 - ratings["rating"]
    )
    ratings.to_csv(study.ratings, index=False)
    results = write_report(study.ratings, study.manifest, tmp_path / "report", draws=20, rng=0)
    assert results.answers["primary"][1].startswith(
        "Similarity to original: Spectral match predicts similarity to original ratings"
    )
    rows = results.numbers.to_dict("records")
    keys = {"scale": "similarity_to_original", "metric": "spectral_match"}
    slope = find_row(rows, "slope", table="slopes", **keys)
    assert slope["low"] < 4.0 < slope["high"]
    one, other = (
        find_row(rows, name, table="associations", method="Pearson", **keys)
        for name in ("r", "r_dissimilarity")
    )
    wanted = (-one["value"], -one["high"], -one["low"])
    assert (other["value"], other["low"], other["high"]) == wanted
    n_tests = 6 * 2 * 4 * len(DEFAULT_REDUCERS)
    assert any(f"{n_tests} of its 576 judgements compare" in note for note in results.notes)


def test_pairs_of_reducers_alone_are_a_page_too(
    write: Callable[..., tuple[Path, Path]], tmp_path: Path
) -> None:
    paths = write([
        ("p", "dissimilarity", "mag321", "dft321", 40),
        ("q", "dissimilarity", "dft321", "mag321", 50),
    ])
    results = write_report(*paths, tmp_path / "report", draws=5, rng=0)
    assert results.figures == {}
    assert any(
        "holds the 0 that compare with the reference, and leaves out 2." in note
        for note in results.notes
    )
    assert "Ratings per reducer" not in read_page(tmp_path / "report")


@pytest.mark.usefixtures("short")
@pytest.mark.usefixtures("sketched")
def test_groups_that_felt_different_levels_are_counted_apart(
    files: Callable[..., object], tmp_path: Path
) -> None:
    study = files(levels=("as_is", "equal_intensity"), scales=("realism", "mushra"), anchors=False)
    ratings = pd.read_csv(study.ratings)
    is_odd = ratings["participant"].isin(["p01", "p03"])
    own = (ratings["level"] == "equal_intensity") == is_odd
    ratings[own & ((ratings["scale"] == "mushra") == is_odd)].to_csv(study.ratings, index=False)
    results = write_report(study.ratings, study.manifest, tmp_path / "report", draws=20, rng=0)
    rows = results.numbers.query("metric == 'spectral_match' and method == 'Pearson'")
    people = rows[rows["quantity"] == "n_participants"].set_index(["scale", "level"])["value"]
    assert people.to_dict() == {("mushra", "equal_intensity"): 2, ("realism", "as_is"): 4}
    assert rows.loc[rows["quantity"] == "n_missing", "value"].max() == 0
