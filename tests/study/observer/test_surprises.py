"""Surprises that no metric knows: stated sums, what leaves them alone, and their recovery by the analysis."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.mixed.model import fit_mixed
from feel321.protocols.trial import Judgement, Part, Trial
from feel321.stimuli.sets.manifest import StimulusSet
from feel321.study.folder import StudyFolder
from feel321.study.observer.model import (
    REAL,
    UNCHANGED,
    Experience,
    Location,
    ObserverModel,
    Touch,
    draw_rater,
)
from feel321.study.observer.percepts import Percept
from feel321.study.settings.read import read_settings
from feel321.study.simulation import regress_planted, simulate_study
from feel321.study.workflow import build_study

if TYPE_CHECKING:
    from pathlib import Path

MODEL = ObserverModel(
    spectral=40.0, temporal=30.0, direction=60.0, vector_magnitude=20.0, reducers={"third": 45.0}
)
ORIGINAL = Location(1.0, 1.0, UNCHANGED, is_reduced=False)


def locate(stimuli: StimulusSet, reducer: str, model: ObserverModel = MODEL) -> Location:
    lost = Percept(0.0, 0.0, 0.0, direction=0.25, vector_magnitude=0.5)
    percepts = {
        one.stimulus_id: UNCHANGED if one.reducer == "original" else lost for one in stimuli
    }
    return Touch(model, percepts).locate(stimuli[f"bumps-{reducer}"])


def ask(protocol: str, test: Location, reference: Location | None) -> float:
    felt = {"test": test} | ({} if reference is None else {"reference": reference})
    parts = tuple(Part(name, name) for name in felt)
    judgement = Judgement("test", "test", reference and "reference")
    trial = Trial(1, 1, 1, protocol, protocol, "replay", "oak", parts, (judgement,))
    return Touch(MODEL, {}).judge(Experience(trial, felt), judgement)


def test_slopes_differ_between_recordings_alike_for_everybody(stimuli: StimulusSet) -> None:
    model = ObserverModel(spectral=40.0, temporal=30.0, slope_sd=10.0)
    own, mean = Touch(model, {}, 1), Touch(model, {})
    scenes: dict[str, list[tuple[float, float, float]]] = {}
    for one in stimuli:
        if one.reducer == "original":
            assert own.feel(own.locate(one)) == mean.feel(mean.locate(one))
        elif one.role == "test":
            point = own.locate(one)
            gained = own.feel(point) - mean.feel(mean.locate(one))
            scenes.setdefault(one.recording, []).append((
                1 - point.spectral,
                1 - point.temporal,
                gained,
            ))
    slopes = []
    for rows in scenes.values():
        values = np.array(rows)
        found, *_ = np.linalg.lstsq(values[:, :2], values[:, 2], rcond=None)
        assert values[:, :2] @ found == pytest.approx(values[:, 2])
        slopes.append(found)
    assert len(np.unique(np.round(slopes, 6))) == np.size(slopes)
    assert own.locate(next(iter(stimuli))) == Touch(model, {}, 1).locate(next(iter(stimuli)))


def test_the_bonus_is_the_reducers_term_and_that_of_its_vector_magnitude(
    stimuli: StimulusSet,
) -> None:
    third, first = locate(stimuli, "third"), locate(stimuli, "first")
    assert (third.bonus, first.bonus) == (55.0, 10.0)
    assert locate(stimuli, "original") == ORIGINAL
    matches = 10 + 40 * 0.2 + 30 * 0.5  # spectral 0.2, temporal 0.5
    assert ask("realism", third, None) == pytest.approx(matches - 60 * 0.25 + 55)


@pytest.mark.parametrize("original", [ORIGINAL, REAL])
def test_it_is_added_to_similarity_and_taken_from_dissimilarity(
    stimuli: StimulusSet, original: Location
) -> None:
    third = locate(stimuli, "third")
    away = 40 * 0.8 + 30 * 0.5 + 60 * 0.25
    assert ask("similarity", third, original) == pytest.approx(100 - away + 55)
    assert ask("mushra", third, original) == pytest.approx(100 - away + 55)
    for first, second in ((third, original), (original, third)):
        assert ask("dissimilarity", first, second) == pytest.approx(away - 55)


def test_between_two_reduced_it_counts_where_one_is_the_reference_only(
    stimuli: StimulusSet,
) -> None:
    third, first = locate(stimuli, "third"), locate(stimuli, "first")
    away = 40 * 0.7 + 30 * 0.3  # both on one axis: the direction is the same
    assert ask("dissimilarity", third, first) == pytest.approx(away)
    assert ask("dissimilarity", first, third) == pytest.approx(away)
    assert ask("similarity", third, first) == pytest.approx(100 - away + 55)
    assert ask("similarity", third, third) == 100


def test_choices_feel_it_too(stimuli: StimulusSet) -> None:
    felt = {"a": locate(stimuli, "third"), "b": locate(stimuli, "first"), "x": ORIGINAL}
    parts = tuple(Part(name, name) for name in felt)
    asked = Judgement("x", "x")
    trial = Trial(1, 1, 1, "abx", "abx", "replay", "oak", parts, (asked,))
    away = Touch(MODEL, {}).compare(Experience(trial, felt), asked, ("a", "b"))
    assert away["a"] == pytest.approx(40 * 0.8 + 30 * 0.5 + 15 - 55)
    assert away["b"] == pytest.approx(40 * 0.1 + 30 * 0.8 + 15 - 10)


STUDY = """
[study]
seed = 5
[[recordings]]
scene = "bumps"
duration_s = 0.2
[[recordings]]
scene = "hard_taps"
duration_s = 0.2
[stimuli]
reducers = ["sax321", "mag321", "dft321"]
anchors = false
[session]
protocols = ["realism"]
[session.rehearsal]
training = 0
practice = 0
[observer]
intercept = 5.0
spectral = 20.0
temporal = 10.0
"""
TERM = "[observer.reducers]\nmag321 = 30.0\n"


def simulate(folder: Path, text: str) -> pd.DataFrame:
    study = StudyFolder(folder)
    folder.mkdir()
    study.settings.write_text(text, encoding="utf-8")
    build_study(study)
    simulate_study(study, participants=3, seed=1, now=lambda: datetime.now(UTC))
    keys = ["participant", "recording", "reducer"]
    return pd.read_csv(study.ratings).set_index(keys)["rating"].sort_index()


def test_the_engine_adds_the_term_and_changes_nothing_else(tmp_path: Path) -> None:
    plain, surprising = (
        simulate(tmp_path / name, text) for name, text in (("a", STUDY), ("b", STUDY + TERM))
    )
    is_mag = plain.index.get_level_values("reducer") == "mag321"
    pd.testing.assert_series_equal(plain[~is_mag], surprising[~is_mag])
    gained = (surprising - plain)[is_mag & (plain > 0)]
    assert len(gained) >= 3
    assert gained.between(15, 45).all()  # 30 points times the participant's gain


def test_planted_slopes_are_told_beside_the_terms(tmp_path: Path, stimuli: StimulusSet) -> None:
    rows = tuple(
        replace(one, spectral_match_bounded=max(one.spectral_match, 0.0)) for one in stimuli
    )
    given = StimulusSet(stimuli.folder, rows, stimuli.sha256)
    exact = "bias_sd = 0.0\ngain_sd = 0.0\nnoise_sd = 0.0\nintercept = 0.0\n"
    head = '[[recordings]]\nscene = "bumps"\n'
    path = tmp_path / "study.toml"
    text = f'{head}[stimuli]\nreducers = ["methods/third.py:third"]\n[observer]\n{exact}'
    path.write_text(text + "[observer.reducers]\nthird = 20.0\n", encoding="utf-8")
    planted = regress_planted(read_settings(path), given)
    assert planted.reducers == pytest.approx({"third": 20.0})
    assert planted.slopes == pytest.approx({"spectral_match_bounded": 4.5, "temporal_match": 3.5})
    assert regress_planted(read_settings(path), given).slopes == planted.slopes


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mag312 = 45.0", r"^study.toml: observer.reducers must be one of .*did you mean 'mag321'"),
        ('mag321 = "much"', "observer.reducers.mag321 must be a valid number, got 'much'"),
        ("mag321 = inf", "observer.reducers.mag321"),
    ],
)
def test_a_wrong_term_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "study.toml"
    head = '[[recordings]]\nscene = "bumps"\n[observer.reducers]\n'
    path.write_text(f"{head}{text}\n", encoding="utf-8")
    with pytest.raises(ValueError, match=message) as found:
        read_settings(path)
    assert "\n" not in str(found.value)


def rate_items(model: ObserverModel, *, people: int, rng: np.random.Generator) -> pd.DataFrame:
    """Rate 12 recordings of 5 reducers, matches and directions at random, by careful participants."""
    touch, rows = Touch(model, {}), list[dict[str, Any]]()
    raters = [draw_rater(model, rng) for _ in range(people)]
    for recording in range(12):
        direction = rng.uniform(0, 0.6)
        for reducer in ("original", "mag321", "sax321", "pca321", "dft321"):
            is_mag, is_reduced = reducer == "mag321", reducer != "original"
            matches = rng.uniform(0, 1, 2) if is_reduced else np.ones(2)
            lost = direction if is_reduced else 0.0
            follows = rng.uniform(0.8, 1.0) if is_mag else rng.uniform(0, 0.2) * is_reduced
            bonus = model.reducers.get(reducer, 0.0) + model.vector_magnitude * follows
            point = Location(*matches, Percept(0.0, 0.0, 0.0, direction=lost), bonus, is_reduced)
            rows += [
                {
                    "participant": f"p{number}", "recording": f"r{recording}", "mag": is_mag * 1.0,
                    "spectral": matches[0], "temporal": matches[1], "direction": lost, "follows": follows,
                    "rating": rater.rate(touch.feel(point), shift=0.0, growth=1.0, rng=rng),
                }
                for number, rater in enumerate(raters)
            ]  # fmt: skip
    return pd.DataFrame(rows)


@pytest.mark.parametrize(
    ("surprise", "column", "planted"),
    [
        ({"reducers": {"mag321": 25.0}}, "mag", 25.0),
        ({"direction": 30.0}, "direction", -30.0),
        ({"vector_magnitude": 25.0}, "follows", 25.0),
    ],
)
def test_planted_surprises_are_recovered_and_the_slopes_hold(
    surprise: dict[str, Any], column: str, planted: float
) -> None:
    model = ObserverModel(
        intercept=30.0, spectral=15.0, temporal=10.0, gain_sd=0.0, noise_sd=5.0, **surprise
    )
    table = rate_items(model, people=20, rng=np.random.default_rng(11))
    formula = f"rating ~ spectral + temporal + {column} + (1 | participant)"
    found = fit_mixed(formula, table).fixed
    truth = {"spectral": 15.0, "temporal": 10.0, column: planted}
    for term, value in truth.items():
        assert abs(found.loc[term, "estimate"] - value) < 3 * found.loc[term, "se"], term
    assert found.loc[column, "se"] < 2.5
