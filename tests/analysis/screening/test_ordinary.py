"""Ordinary raters are left alone whatever the protocol and the steps of its scale; bad ones are found."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.screening import RULES, SIGHTED, screen_raters

RECORDINGS, REDUCERS, PEOPLE = 6, 5, 16
REFERENCE = {"realism": 78.0, "similarity": 84.0, "mushra": 97.0}
"""Where the original stands: by itself it is hardly ever felt as perfect, and only beside it is it known again."""

BAD = {"straight_liner": 3, "random": 7, "reversed": 11}
REAL = Path(__file__).parents[4] / "shared" / "ratings" / "netflix_public_outliers"


def simulate(protocol: str, *, steps: int = 0, seed: int = 0, bad: bool = False) -> pd.DataFrame:
    """Rate stimuli as the package's own observers do: bias, gain and noise of each person, twice each stimulus."""
    rng = np.random.default_rng([seed, steps, len(protocol)])
    places = {"original": REFERENCE[protocol], "anchor_mid": 35.0, "anchor_low": 12.0}
    places |= {f"reducer{number}": 25.0 + 12 * number for number in range(REDUCERS)}
    names = [(f"r{scene}", reducer) for scene in range(RECORDINGS) for reducer in places]
    felt = np.array([
        places[reducer] + (reducer != "original") * rng.normal(0, 6) for _, reducer in names
    ])
    original = np.array([reducer == "original" for _, reducer in names])
    parts = []
    for person in range(PEOPLE):
        bias, gain = rng.normal(0, 6), np.exp(rng.normal(0, 0.15))
        noise = 8 * np.exp(rng.normal(0, 0.2))
        percept = 50 + gain * (felt - 50) + bias
        for repeat in (1, 2):
            rating = percept + rng.normal(0, noise, len(felt))
            if protocol in SIGHTED:  # who knows the reference again puts it at the top
                rating = np.where(original, 100 - np.abs(rng.normal(0, 3, len(felt))), rating)
            rating = _spoil(person, rating, rng) if bad else rating
            part = pd.DataFrame(names, columns=["recording", "reducer"])
            parts.append(part.assign(participant=f"p{person:02d}", repeat=repeat, rating=rating))
    table = pd.concat(parts)
    roles = {"original": "reference", "anchor_mid": "anchor", "anchor_low": "anchor"}
    kinds = table["reducer"].map(roles)
    ratings = table["rating"].clip(0, 100).round(1)
    if steps:
        ratings = (ratings * (steps - 1) / 100).round() * 100 / (steps - 1)
    return table.assign(
        role=kinds.fillna("test"), rating=ratings, scale=protocol, protocol=protocol
    )


def _spoil(person: int, rating: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    if person == BAD["straight_liner"]:
        return 60 + rng.normal(0, 0.5, len(rating))
    if person == BAD["random"]:
        return rng.uniform(0, 100, len(rating))
    return 100 - rating if person == BAD["reversed"] else rating


@pytest.mark.parametrize("steps", [0, 5, 7])
@pytest.mark.parametrize("protocol", REFERENCE)
def test_ordinary_raters_are_left_alone_and_bad_ones_found(protocol: str, steps: int) -> None:
    good = [
        screen_raters(simulate(protocol, steps=steps, seed=seed), rng=np.random.default_rng(0))
        for seed in (0, 1)
    ]
    assert sum(table.hit.any(axis=1).sum() for table in good) <= 0.05 * 2 * PEOPLE
    spoiled = screen_raters(simulate(protocol, steps=steps, bad=True), rng=np.random.default_rng(0))
    assert {f"p{number:02d}" for number in BAD.values()} <= set(
        spoiled.hit.index[spoiled.hit.any(axis=1)]
    )
    assert f"p{BAD['straight_liner']:02d}" in spoiled.hits["straight_lining"]
    assert f"p{BAD['reversed']:02d}" in spoiled.hits["reversed_scale"]
    assert f"p{BAD['random']:02d}" in spoiled.hits["test_retest"]


@pytest.mark.parametrize("protocol", ["realism", "similarity"])
def test_rules_of_mushra_are_not_applied_to_other_protocols(protocol: str) -> None:
    table = simulate(protocol)
    bound = [name for name, rule in RULES.items() if rule.protocols == SIGHTED]
    found = screen_raters(table)
    assert found.share[bound].isna().all(axis=None)
    note = f"Rules {', '.join(map(repr, bound))} not applied: for MUSHRA ratings, where the reference is in sight; "
    assert f"{note}these are of {protocol}." in found.notes
    # The same ratings as MUSHRA: nearly nobody knows the reference again.
    assert len(screen_raters(table.assign(protocol="mushra")).hits["hidden_reference"]) > PEOPLE / 2
    both = screen_raters(pd.concat([table, simulate("mushra")]))
    assert both.count["hidden_reference"].max() == 0
    assert both.table["n"].max() == 2 * 2 * RECORDINGS * REDUCERS
    assert set(both.table.query("rule == 'hidden_reference'")["n"]) == {2 * RECORDINGS}


def test_a_protocol_that_is_not_given_is_assumed_and_named() -> None:
    table = simulate("realism").drop(columns="protocol")
    assumed = f"No protocol is given for {len(table)} ratings: assumed "
    assert f"{assumed}from their scale (realism)." in screen_raters(table).notes
    bare = table.assign(scale="comfort")
    missing = (
        "not applied: for MUSHRA ratings, where the reference is in sight; a column protocol that "
        "says so is missing."
    )
    assert any(note.endswith(missing) for note in screen_raters(bare).notes)
    assert not screen_raters(bare).hits["hidden_reference"]
    asked = screen_raters(bare, rules=["hidden_reference"])
    assert asked.notes == (f"{assumed}mushra, with a reference in sight.",)
    assert asked.hits["hidden_reference"]
    # Nothing is assumed where no rule asks for it, and a gap in the column is one row's.
    assert screen_raters(bare, rules=["outliers"]).notes == ()
    gap = table.assign(protocol=["", None, *["realism"] * (len(table) - 2)])
    assert (
        "No protocol is given for 2 ratings: assumed from their scale (realism)."
        in screen_raters(gap).notes
    )


def test_a_scale_of_few_steps_is_known_by_its_steps() -> None:
    for steps, step in ((0, 0), (3, 50), (5, 25), (11, 10), (21, 0)):
        found = screen_raters(simulate("realism", steps=steps), rules=["repeat_sd"]).limit[
            "repeat_sd"
        ]
        np.testing.assert_allclose(found, np.sqrt(0.2**2 + (step / 100) ** 2 / 12))
    # Sliders left at few places are no steps: everybody at one of two neighbouring points.
    lazy = simulate("realism").assign(rating=lambda table: 50 + (table["rating"] > 50))
    assert len(screen_raters(lazy, rules=["straight_lining"]).hits["straight_lining"]) == PEOPLE


@pytest.mark.skipif(
    not REAL.is_dir(), reason=f"{REAL} is missing: the real ratings are not part of the project"
)
def test_planted_outliers_of_real_ratings_are_found_and_nobody_else() -> None:
    table = pd.read_csv(REAL / "ratings.csv").merge(
        pd.read_csv(REAL / "manifest.csv"), on="stimulus_id"
    )
    found = screen_raters(table, rng=np.random.default_rng(0))
    assert found.hits["outliers"] == ("s26", "s27", "s28", "s29")
    assert set(found.hit.index[found.hit.any(axis=1)]) == {"s26", "s27", "s28", "s29"}
    ordinary = screen_raters(table[table["participant"] < "s26"], rng=np.random.default_rng(0))
    assert ordinary.hits == dict.fromkeys(RULES, ())
