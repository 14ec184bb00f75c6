from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from feel321.protocols.trial import SURFACE, Judgement, Part, Scale, Trial
from feel321.stimuli.sets.manifest import Stimulus
from feel321.study.observer import SPECTRAL, ObserverModel, SimulatedObserver, Touch
from feel321.study.session.ports import Confirm, Feel, Place


def vary(model: ObserverModel, **changes: object) -> ObserverModel:
    return ObserverModel(**{**model.model_dump(), **changes})


MODEL = ObserverModel()
EXACT = vary(MODEL, bias_sd=0.0, gain_sd=0.0, noise_sd=0.0, noise_spread=0.0)
# Every percept is 50 points, so that nothing but what a test plants moves a rating.
FLAT = vary(EXACT, intercept=50.0, spectral=0.0, temporal=0.0)
SLIDER = Scale("any", "?", "low", "high")


def make_stimulus(name: str, spectral: float, temporal: float) -> Stimulus:
    audio = (f"{name}.wav", 48000.0, 48000, 1.0, 0.5, 1.0, 1.0)
    return Stimulus(name, "oak", name, "as_is", "test", *audio, spectral, temporal, 0, "", "")


def make_stimuli(n: int = 40) -> dict[str, Stimulus]:
    """Stimuli under codes, whose matches are drawn independently."""
    rng = np.random.default_rng(8)
    return {f"code{i}": make_stimulus(f"s{i}", rng.uniform(), rng.uniform()) for i in range(n)}


STIMULI = make_stimuli()
OTHERS = {
    "original": make_stimulus("original", 1.0, 1.0),
    "near": make_stimulus("near", 1.0, 0.9),
    "far": make_stimulus("far", 0.0, 0.0),
    "beyond": make_stimulus("beyond", -3.0, 0.0),
    "above": make_stimulus("above", 1.2, 0.0),
}


def make_realism(number: int, code: str, *, phase: str = "main") -> Trial:
    part, judgement = Part("test", code), Judgement("test", code)
    return Trial(number, 1, 1, "realism", "realism", "replay", "oak", (part,), (judgement,), phase)


def make_mushra(number: int, codes: Sequence[str]) -> Trial:
    slots = [Part(str(slot), code) for slot, code in enumerate(codes, start=1)]
    judgements = tuple(Judgement(part.name, str(part.stimulus_id), "original") for part in slots)
    parts = (Part("reference", "original"), *slots)
    return Trial(number, 1, 1, "mushra", "mushra", "free", "oak", parts, judgements)


def make_main(n: int) -> list[Trial]:
    """Trials of a session, every stimulus as often as the others, in no order."""
    codes = np.random.default_rng(21).permutation(np.resize(list(STIMULI), n))
    return [make_realism(number, str(code)) for number, code in enumerate(codes, start=1)]


def feel(observer: SimulatedObserver, part: Part) -> None:
    if part.stimulus_id is None:
        observer.prompt(part)
    else:
        observer.play(part, (STIMULI | OTHERS)[part.stimulus_id], gap_s=0.5)


def answer(observer: SimulatedObserver, trial: Trial, *, attempt: int = 1) -> Confirm:
    """Lead a participant through a trial, as the engine does, to the answer."""
    observer.show_trial(trial, SLIDER, Place(0, 20, attempt))
    for part in trial.parts if trial.timing != "free" else ():
        feel(observer, part)
    while isinstance(act := observer.wait(), Feel):
        feel(observer, next(part for part in trial.parts if part.name == act.part))
    assert isinstance(act, Confirm)
    return act


def rate_all(observer: SimulatedObserver, trials: Iterable[Trial]) -> np.ndarray:
    return np.array([answer(observer, trial).values["test"] for trial in trials])


def fit(ratings: np.ndarray, *columns: Sequence[float]) -> np.ndarray:
    """Least squares; the intercept first."""
    design = np.column_stack([np.ones(len(ratings)), *columns])
    return np.linalg.lstsq(design, ratings, rcond=None)[0]


def matches(trials: Iterable[Trial]) -> tuple[list[float], list[float]]:
    felt = [STIMULI[str(trial.parts[0].stimulus_id)] for trial in trials]
    return [s.spectral_match for s in felt], [s.temporal_match for s in felt]


def test_planted_weights_on_the_matches_are_recovered() -> None:
    trials = make_main(4000)
    exact = dict.fromkeys(("bias_sd", "gain_sd", "noise_spread"), 0.0)
    model = vary(MODEL, intercept=15.0, spectral=40.0, temporal=25.0, **exact)
    found = fit(rate_all(SimulatedObserver(model, seed=1, number=1), trials), *matches(trials))
    assert found == pytest.approx([15.0, 40.0, 25.0], rel=0.06)


def test_the_real_surface_is_stroked_and_stands_for_the_original() -> None:
    parts = (Part("reference", surface="oak"), Part("test", "far"))
    names, judged = ("similarity", "similarity", "replay", "oak"), Judgement("test", "far", SURFACE)
    trial = Trial(1, 1, 1, *names, parts, (judged,))
    observer = SimulatedObserver(EXACT, seed=1, number=1)
    assert answer(observer, trial).values["test"] == 20.0
    assert observer.prompt(parts[0]).completed


def test_seed_number_trial_and_attempt_decide_and_nothing_else() -> None:
    trial = make_realism(5, "code1")

    def ask(
        *,
        seed: int = 1,
        number: int = 1,
        trial: Trial = trial,
        attempt: int = 1,
        late_s: float = 0.0,
    ) -> object:
        observer = SimulatedObserver(
            vary(FLAT, noise_sd=9.0), seed=seed, number=number, elapsed_s=late_s
        )
        answer(observer, make_realism(2, "code2"))
        return answer(observer, trial, attempt=attempt).values

    assert ask() == ask() == ask(late_s=99.0)
    others = [ask(seed=2), ask(number=2), ask(trial=replace(trial, number=6)), ask(attempt=2)]
    assert all(other != ask() for other in others)


@pytest.mark.parametrize("broken_after", [0, 1, 7, 19])
def test_a_resumed_session_gives_the_answers_and_times_of_an_unbroken_one(
    broken_after: int,
) -> None:
    model = vary(MODEL, lapse_rate=0.1)
    trials = [*make_main(18), make_mushra(19, ["code1", "far"]), make_mushra(20, ["near", "code5"])]
    unbroken = SimulatedObserver(model, seed=3, number=2)
    whole = [answer(unbroken, trial) for trial in trials]
    elapsed_s = whole[broken_after - 1].time_s if broken_after else 0.0
    resumed = SimulatedObserver(model, seed=3, number=2, elapsed_s=elapsed_s)
    assert [answer(resumed, trial) for trial in trials[broken_after:]] == whole[broken_after:]


def test_people_feel_by_the_spectral_match_that_is_declared() -> None:
    stimulus = replace(make_stimulus("s", -3.0, 0.5), spectral_match_bounded=0.25)
    bounded, raw = (Touch(vary(MODEL, spectral_metric=name)) for name in SPECTRAL)
    assert bounded.locate(stimulus).spectral == 0.25
    assert raw.locate(stimulus).spectral == 0.0
    assert raw.locate(replace(stimulus, spectral_match=0.5)).spectral == 0.5
    # The bounded match may be unknown.
    assert bounded.locate(make_stimulus("s", 0.5, 0.5)).spectral == 0.5
