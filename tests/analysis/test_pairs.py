"""Judgements of two stimuli at once: whose they are, what they leave out, and what they may not claim."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.association import make_panel
from feel321.analysis.report.section import find_row
from feel321.analysis.report.write import write_report
from feel321.analysis.table.items import open_tests, split_tests
from feel321.analysis.table.reading import Table, read_table
from feel321.stimuli.reducers.registry import DEFAULT_REDUCERS

Write = Callable[..., tuple[Path, Path]]

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
            "stimulus_id", "recording", "reducer", "level", "role", "spectral_match", "temporal_match",
        ]  # fmt: skip
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


def test_a_dissimilarity_is_about_what_was_compared_with_the_reference(write: Write) -> None:
    table = read_table(*write(PAIRS))
    assert list_judged(table) == [
        ("mag321", "test"), ("dft321", "test"), ("orig", "reference"), ("dft321", "pair"),
        ("dft321", "reference"), ("anchor_low", "anchor"), ("anchor_low", "anchor"), ("mag321", "pair"),
    ]  # fmt: skip
    assert list(table.rows["reducer"]) == list(table.rows["stimulus_id"])
    assert list(table.rows["rating"]) == [row[-1] for row in PAIRS]


def test_a_reducer_judged_against_itself_is_the_hidden_reference(write: Write) -> None:
    judgements = [("p", "mushra", name, "dft321", 50) for name in STIMULI]
    table = read_table(*write(judgements))
    assert list_judged(table) == list((STIMULI | {"dft321": "reference"}).items())


def test_without_reference_every_dissimilarity_is_from_the_reference(write: Write) -> None:
    judgements = [("p", "dissimilarity", name, "", 60) for name in ("mag321", "orig")]
    table = read_table(*write(judgements))
    assert list_judged(table) == [("mag321", "test"), ("orig", "reference")]
    note = "2 judgements of scale 'dissimilarity' name no reference_id: they are taken as from the reference."
    assert note in table.notes


def test_an_unknown_partner_is_refused(write: Write) -> None:
    message = "ratings.csv, line 3: reference_id must be a stimulus of the manifest, or empty, in"
    with pytest.raises(ValueError, match=message):
        read_table(*write([PAIRS[0], ("p", "dissimilarity", "mag321", "ghost", 60)]))


def test_pairs_are_told_apart_by_both_where_repeats_count(write: Write) -> None:
    paths = write([("p", "dissimilarity", "mag321", name, 60) for name in ("orig", "dft321")])
    frame = pd.read_csv(paths[0]).drop(columns="trial")
    frame.to_csv(paths[0], index=False)
    assert list(read_table(*paths).rows["repeat"]) == ["1", "1"]
    frame.assign(repeat=1).to_csv(paths[0], index=False)
    assert len(read_table(*paths).rows) == 2
    pd.concat([frame, frame]).assign(repeat=1).to_csv(paths[0], index=False)
    told = "ratings.csv, lines 4, 5: repeat must occur once with the same participant, scale,"
    with pytest.raises(ValueError, match=told):
        read_table(*paths)


def test_metrics_speak_only_of_what_was_judged_against_its_recording(write: Write) -> None:
    references = ["surface", "dft321", "ghost", "orig", "", "elsewhere"]
    paths = write([("p", "similarity", "mag321", name, 40) for name in references])
    manifest = pd.read_csv(paths[1])
    other = manifest[manifest["stimulus_id"] == "orig"]
    other = other.assign(stimulus_id="elsewhere", recording="s")
    pd.concat([manifest, other]).to_csv(paths[1], index=False)
    table = read_table(*paths)
    assert dict(zip(references, table.rows["matched"], strict=True)) == {
        "surface": True, "dft321": False, "ghost": True, "orig": True, "": True, "elsewhere": False,
    }  # fmt: skip
    assert any("were made against a stimulus of another recording" in note for note in table.notes)
    left_out = "2 judgements against other references are left out."
    assert left_out in open_tests(table)[1]
    assert not any(
        "other references" in note
        for note in open_tests(replace(table, rows=table.rows[table.rows["matched"]]))[1]
    )
    assert [len(part.rows) for part in split_tests(table)] == [4]
    assert [len(part.rows) for part in split_tests(table, matched=False)] == [6]


def test_a_dissimilarity_from_the_original_is_a_similarity_turned_round(
    tidy: Callable[..., pd.DataFrame],
) -> None:
    likeness = tidy(scales=("similarity",))
    turned = likeness.assign(scale="dissimilarity", rating=100 - likeness["rating"])
    pairs_too = turned.assign(role=turned["role"].where(turned["role"] != "test", "pair"))
    (given,), (recast,) = (
        list(split_tests(rows)) for rows in (likeness, pd.concat([turned, pairs_too]))
    )
    assert recast.scale == "similarity_to_original"
    plain, again = (
        make_panel(one.rows, ("spectral_match",), draws=20, rng=np.random.default_rng(1))
        for one in (given, recast)
    )
    for one, other in zip(plain.associations, again.associations, strict=True):
        assert other.value == pytest.approx(one.value)
        assert (other.n_items, one.value > 0.3) == (one.n_items, True)


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
    n_tests = 6 * 2 * 4 * len(DEFAULT_REDUCERS)
    assert any(f"{n_tests} of its 576 judgements compare" in note for note in results.notes)
