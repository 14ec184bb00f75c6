"""What stimuli feel like to simulated participants: stated sums, and surprises that no metric knows, recovered."""

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feel321.analysis.mixed.model import fit_mixed
from feel321.protocols.trial import SURFACE, Judgement, Part, Trial
from feel321.stimuli.sets.manifest import StimulusSet
from feel321.study.check import build_study
from feel321.study.folder import StudyFolder
from feel321.study.observer import REAL, Experience, Location, ObserverModel, Touch, draw_rater
from feel321.study.settings.read import read_settings
from feel321.study.simulate import regress_planted, simulate_study
from tests.study.conftest import make_settings

MODEL = ObserverModel(spectral=40.0, temporal=30.0, reducers={"third": 45.0})
TOUCH = Touch(MODEL)
WEAK, STRONG = Location(0.6, 0.5), Location(0.2, 0.9)
THIRD, FIRST = Location(0.2, 0.5, 45.0), Location(0.9, 0.2, 0.0)

shares = st.floats(0, 1)
points = st.builds(Location, shares, shares)


def make_experience(
    protocol: str, felt: dict[str, Location], *, reference: str | None = None, part: str = "test"
) -> Experience:
    parts = tuple(Part(name, f"code-{name}") for name in felt)
    judgement = Judgement(part, f"code-{part}", reference and f"code-{reference}")
    trial = Trial(1, 1, 1, protocol, protocol, "replay", "oak", parts, (judgement,))
    return Experience(trial, felt)


def ask(protocol: str, test: Location, reference: Location | None = None) -> float:
    felt = {"test": test} | ({} if reference is None else {"reference": reference})
    experience = make_experience(protocol, felt, reference=reference and "reference")
    return TOUCH.judge(experience, experience.trial.judgements[0])


def test_judgements_are_the_stated_sums() -> None:
    assert (TOUCH.feel(REAL), ask("realism", WEAK)) == pytest.approx((80, 10 + 24 + 15))
    assert ask("dissimilarity", WEAK, STRONG) == pytest.approx(16 + 12)
    for protocol in ("similarity", "mushra"):
        assert ask(protocol, WEAK, STRONG) == pytest.approx(100 - 28)
        assert ask(protocol, WEAK, WEAK) == 100
    parts = (Part("reference", surface="oak"), Part("test", "code"))
    judgement = Judgement("test", "code", SURFACE)
    trial = Trial(1, 1, 1, "similarity", "similarity", "replay", "oak", parts, (judgement,))
    felt = Experience(trial, {"reference": TOUCH.locate(None), "test": WEAK})
    assert TOUCH.judge(felt, judgement) == pytest.approx(20 + TOUCH.feel(WEAK))


@given(a=points, b=points, c=points)
def test_distance_is_a_metric(a: Location, b: Location, c: Location) -> None:
    measure = TOUCH.measure_distance
    assert measure(a, a) == 0
    assert measure(a, b) == measure(b, a) >= 0
    assert measure(a, c) <= measure(a, b) + measure(b, c) + 1e-9


def test_candidates_are_as_far_as_they_feel_from_what_is_asked() -> None:
    abx = make_experience("abx", {"a": WEAK, "b": STRONG, "x": STRONG}, part="x")
    assert TOUCH.compare(abx, abx.trial.judgements[0], ("a", "b")) == pytest.approx({
        "a": 28.0,
        "b": 0.0,
    })
    felt = {"reference": REAL, "a": WEAK, "b": STRONG}
    triplet = make_experience("triplet", felt, reference="reference", part="a")
    assert TOUCH.compare(triplet, triplet.trial.judgements[0], ("a", "b")) == pytest.approx({
        "a": TOUCH.measure_distance(REAL, WEAK),
        "b": TOUCH.measure_distance(REAL, STRONG),
    })


def test_what_cannot_be_judged_is_refused() -> None:
    astray = make_experience("similarity", {"test": WEAK}, reference="elsewhere")
    with pytest.raises(ValueError, match=r"stimulus of one of its parts, got 'code-elsewhere'"):
        TOUCH.judge(astray, astray.trial.judgements[0])
    with pytest.raises(KeyError, match=r"must be one of realism, similarity.*got 'pinching'"):
        ask("pinching", WEAK)


# Surprises.


def test_the_bonus_is_the_reducers_term_and_counts_where_it_is_judged(stimuli: StimulusSet) -> None:
    assert TOUCH.locate(stimuli["bumps-third"]) == THIRD
    assert TOUCH.locate(stimuli["bumps-first"]) == FIRST
    assert TOUCH.locate(stimuli["bumps-original"]) == REAL
    assert ask("realism", THIRD) == pytest.approx(10 + 8 + 15 + 45)
    away, apart = 40 * 0.8 + 30 * 0.5, 40 * 0.7 + 30 * 0.3
    for protocol in ("similarity", "mushra"):
        assert ask(protocol, THIRD, REAL) == pytest.approx(100 - away + 45)
        assert ask(protocol, THIRD, FIRST) == pytest.approx(100 - apart + 45)
        assert ask(protocol, THIRD, THIRD) == 100
    for pair, distance in (((THIRD, REAL), away - 45), ((THIRD, FIRST), apart)):
        assert ask("dissimilarity", *pair) == pytest.approx(distance)
        assert ask("dissimilarity", *pair[::-1]) == pytest.approx(distance)


def test_slopes_differ_between_recordings_alike_for_everybody(stimuli: StimulusSet) -> None:
    model = ObserverModel(spectral=40.0, temporal=30.0, slope_sd=10.0)
    own, mean = Touch(model, 1), Touch(model)
    scenes: dict[str, list[tuple[float, float, float]]] = {}
    for one in stimuli:
        point = own.locate(one)
        gained = own.feel(point) - mean.feel(mean.locate(one))
        assert one.reducer != "original" or gained == 0
        row = (1 - point.spectral, 1 - point.temporal, gained)
        scenes.setdefault(one.recording, []).append(row)
    slopes = []
    for rows in scenes.values():
        values = np.array(rows)
        found, *_ = np.linalg.lstsq(values[:, :2], values[:, 2], rcond=None)
        assert values[:, :2] @ found == pytest.approx(values[:, 2])
        slopes.append(found)
    assert len(np.unique(np.round(slopes, 6))) == np.size(slopes)
    assert own.locate(next(iter(stimuli))) == Touch(model, 1).locate(next(iter(stimuli)))


STUDY = make_settings(
    "bumps",
    "hard_taps",
    duration_s=0.2,
    reducers=("sax321", "mag321", "dft321"),
    stimuli="anchors = false\n",
)
STUDY += "[study]\nseed = 5\n[observer]\nintercept = 5.0\nspectral = 20.0\ntemporal = 10.0\n"


def simulate(folder: Path, text: str) -> pd.DataFrame:
    study = StudyFolder(folder)
    folder.mkdir()
    study.settings.write_text(text, encoding="utf-8")
    build_study(study)
    simulate_study(study, participants=3, seed=1, now=lambda: datetime.now(UTC))
    keys = ["participant", "recording", "reducer"]
    return pd.read_csv(study.ratings).set_index(keys)["rating"].sort_index()


def test_the_engine_adds_the_term_and_changes_nothing_else(tmp_path: Path) -> None:
    term = "[observer.reducers]\nmag321 = 30.0\n"
    plain = simulate(tmp_path / "a", STUDY)
    surprising = simulate(tmp_path / "b", STUDY + term)
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
    slopes, reducers = regress_planted(read_settings(path), given)
    assert reducers == pytest.approx({"third": 20.0})
    assert slopes == pytest.approx({"spectral_match_bounded": 4.5, "temporal_match": 3.5})


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ('[analysis]\nmetrics = ["spectral_match", "temporal_match"]\n', ["spectral_match", "temporal_match"]),
        ('[session]\nprotocols = ["similarity"]\n', []),
    ],
)  # fmt: skip
def test_the_declared_metric_is_felt_and_without_realism_nothing_is_planted(
    tmp_path: Path, stimuli: StimulusSet, text: str, named: list[str]
) -> None:
    path = tmp_path / "study.toml"
    path.write_text(f'[[recordings]]\nscene = "bumps"\n{text}', encoding="utf-8")
    assert list(regress_planted(read_settings(path), stimuli)[0]) == named


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
    with pytest.raises(ValueError, match=message):
        read_settings(path)


def test_a_planted_surprise_is_recovered_and_the_slopes_hold() -> None:
    """12 recordings of 5 reducers, matches at random, rated by 20 careful participants."""
    rng, rows = np.random.default_rng(11), list[dict[str, Any]]()
    touch = Touch(
        ObserverModel(intercept=30.0, spectral=15.0, temporal=10.0, gain_sd=0.0, noise_sd=5.0)
    )
    raters = [draw_rater(touch.model, rng) for _ in range(20)]
    for recording in range(12):
        for reducer in ("original", "mag321", "sax321", "pca321", "dft321"):
            is_mag, is_reduced = reducer == "mag321", reducer != "original"
            spectral, temporal = rng.uniform(0, 1, 2) if is_reduced else np.ones(2)
            point = Location(spectral, temporal, 25.0 * is_mag, is_reduced)
            rows += [
                {
                    "participant": f"p{number}", "recording": f"r{recording}", "mag": is_mag * 1.0,
                    "spectral": spectral, "temporal": temporal,
                    "rating": rater.rate(touch.feel(point), rng),
                }
                for number, rater in enumerate(raters)
            ]  # fmt: skip
    formula = "rating ~ spectral + temporal + mag + (1 | participant)"
    found = fit_mixed(formula, pd.DataFrame(rows)).fixed
    for term, value in {"spectral": 15.0, "temporal": 10.0, "mag": 25.0}.items():
        assert abs(found.loc[term, "estimate"] - value) < 3 * found.loc[term, "se"], term
    assert found.loc["mag", "se"] < 2.5
