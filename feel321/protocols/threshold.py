"""Blocks before the trials that are rated: detection thresholds, and strength matched by the participant.

Threshold, by two-alternative forced choice: of two intervals one holds the vibration. Which one, and how strongly,
follows from the answers that counted so far, by a staircase (Levitt 1971, doi:10.1121/1.1912375) or a Bayesian
procedure (Kontsevich & Tyler 1999, doi:10.1016/S0042-6989(98)00285-5; Watson 2017, doi:10.1167/17.3.10), and from
nothing else, so that a trial that was rejected comes again alike and a resumed session goes on with the same sequence.

The threshold is the level at which a share of 2^(-1/n_down) of the answers is correct, lapses included: 79.4 % for the
usual three down, one up. The psychometric function is a Weibull function of amplitude,

    P(x) = 1/2 + (1/2 - lapse) (1 - exp(-k 10^(slope (x - threshold) / 20))),

k such that P(threshold) = 2^(-1/n_down). Why not the package `questplus`: it is under the GPL.

Matching (the method of adjustment) checks stimuli that should be equally strong: the participant moves a marker until
`second` feels as strong as `first`, the recording itself. The marker moves its level by `DB_PER_POINT` around one that
is drawn for each trial, so that its place tells nothing. Both are played `ATTENUATION_DB` weaker than in the study,
which leaves room for the strongest second. The recording is matched with itself too: what is not 0 dB there is how
participants use the marker, and the error of time of the second interval.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from feel321.arguments import as_rng, check_name, describe
from feel321.protocols.tasks import find_reference
from feel321.protocols.trial import MATCHING, RATING_RANGE, THRESHOLD, Item, Judgement, Part, Trial
from feel321.types import Samples

GUESS = 0.5  # share of correct answers without any vibration
SLOPES = (1.0, 8.0, 16)  # Weibull slopes thought possible: from, to, how many, in geometric steps
MARGIN_DB = 6.0  # how far beyond the rig's levels a threshold is thought possible, so that one at a limit shows
THRESHOLD_STEP_DB, LEVEL_STEP_DB = 0.5, 1.0  # of thresholds thought possible; of levels presented
DESCENT = 2  # correct in a row to go down until the first wrong one: 1 would dive on lucky guesses
MOST_DB = 200  # widest range of levels
UNLIKELY = 0.05  # probability under guessing below which answers are remarked on


@dataclass(frozen=True, slots=True)
class ThresholdPlan:
    """Settings of a threshold measurement."""

    lowest_db: float
    highest_db: float
    start_db: float
    trials: int = 60
    catch_every: int = 10  # trials within which one silent catch trial comes; 0: none
    n_down: int = 3  # correct answers in a row before a staircase goes down
    steps_db: tuple[float, ...] = (8.0, 4.0, 2.0)  # the next one after each reversal
    lapse: float = 0.04  # assumed share of wrong answers to the strongest vibration
    seed: int = 0  # of intervals and catch trials

    def __post_init__(self) -> None:
        """Refuse levels out of order; the settings check the numbers of trials, and nobody sets the rest."""
        low, start, high = self.lowest_db, self.start_db, self.highest_db
        if not (0 < high - low <= MOST_DB and low <= start <= high):
            must = f"highest_db must be above lowest_db, by {MOST_DB} dB at most, and start_db between them"
            raise ValueError(f"{must}; got {high}, {low} and {start}")

    @property
    def proportion(self) -> float:
        """Share of correct answers at the threshold, 2^(-1/n_down)."""
        return math.pow(0.5, 1 / self.n_down)

    @property
    def presentations(self) -> int:
        """Number of all trials, those of silence among them."""
        return self.trials + (self.trials // self.catch_every if self.catch_every else 0)


USUAL = ThresholdPlan(-60.0, 0.0, -5.0)  # of 20 to 300 Hz at the hand, in dB relative to 1 m/s² RMS


@dataclass(frozen=True, slots=True)
class Presentation:
    """A trial to present: the interval (1 or 2) that holds the vibration, and its level; None is silence in both."""

    interval: int
    level_db: float | None


@dataclass(frozen=True, slots=True)
class ThresholdEstimate:
    """A person's detection threshold in dB and Weibull slope, with 95 % intervals; NaN where there is no estimate."""

    threshold_db: float
    threshold_low_db: float
    threshold_high_db: float
    slope: float
    slope_low: float
    slope_high: float
    catch_trials: int
    catch_correct: int
    is_beyond: bool
    notes: tuple[str, ...]


def predict_correct(
    level_db: Samples | float,
    plan: ThresholdPlan = USUAL,
    *,
    threshold_db: Samples | float,
    slope: Samples | float,
    lapse: float | None = None,
) -> Samples:
    """Predict the share of correct answers, P(x) of this module's equation; arguments broadcast."""
    height = 1 - GUESS - (plan.lapse if lapse is None else lapse)
    scale = -math.log1p(-(plan.proportion - GUESS) / height)
    rise = -scale * np.power(10.0, slope * (level_db - threshold_db) / 20)
    chances: Samples = GUESS - height * np.expm1(rise)
    return chances


PROCEDURES = ("staircase", "bayesian")
"""Transformed up-down: down after `n_down` correct answers in a row, up after each wrong one; the estimate is the mean
of an even number of reversals made with the last step, its slope and intervals those of the posterior, for reversals
depend on each other. Or each level chosen for the least expected entropy of threshold and slope after its answer.
"""


class Procedure:
    """A measurement as ask/tell: the trials' order, what was answered, and the posterior given that."""

    def __init__(self, name: str, plan: ThresholdPlan) -> None:
        self.is_staircase = check_name(name, PROCEDURES, "procedure") == "staircase"
        self.plan = plan
        self.shown: list[Presentation] = []
        self.answers: list[int] = []
        self.reversals: list[float] = []
        self._level, self._run, self._direction = plan.start_db, 0, 0
        self.weights = np.ones_like(_predict_grid(plan, plan.start_db))
        self.weights /= self.weights.sum()
        # Each trial's interval, and whether it is a catch trial.
        rng, silent, every = as_rng(plan.seed, "seed"), [False] * plan.trials, plan.catch_every
        for block in reversed(range(plan.trials // every if every else 0)):
            silent.insert(block * every + int(rng.integers(1, every + 1)), True)
        self._order = list(zip(rng.integers(1, 3, len(silent)).tolist(), silent, strict=True))

    @property
    def left(self) -> int:
        """Number of trials that are not answered."""
        return len(self._order) - len(self.answers)

    def next(self) -> Presentation | None:
        """Return the trial to present, the same one until it is answered; None when all are done."""
        if not self.left:
            return None
        interval, silent = self._order[len(self.answers)]
        if silent or self.is_staircase:
            return Presentation(interval, None if silent else self._level)
        # The level with the greatest mutual information of answer and parameters, h(E[P]) - E[h(P)]: the expected
        # loss of entropy; rounded, so that another processor's last bit changes nothing.
        levels, chances, entropies = _make_tables(replace(self.plan, seed=0))
        weights = self.weights.ravel()
        gained = _binary_entropy(chances @ weights) - entropies @ weights
        return Presentation(interval, float(levels[gained.round(9).argmax()]))

    def update(self, answer: int) -> None:
        """Take the answered interval, 1 or 2, of the trial that `next` gives."""
        trial = self.next()
        if trial is None:
            raise ValueError(f"all {len(self.answers)} trials are answered, got one more answer")
        if isinstance(answer, bool) or answer not in {1, 2}:
            raise ValueError(f"answer must be the interval 1 or 2, got {describe(answer)}")
        self.shown.append(trial)
        self.answers.append(int(answer))
        if trial.level_db is not None:
            correct = answer == trial.interval
            chances = _predict_grid(self.plan, trial.level_db)
            weights = self.weights * (chances if correct else 1 - chances)
            self.weights = weights / weights.sum()
            self._step(trial.level_db, correct=correct)

    def _step(self, level_db: float, *, correct: bool) -> None:
        """Move the level of a staircase."""
        plan, self._run = self.plan, self._run + 1 if correct else 0
        descending = not self.reversals and self._direction <= 0
        if correct and self._run < (DESCENT if descending else plan.n_down):
            return
        self._run, direction = 0, -1 if correct else 1
        if direction == -self._direction:
            self.reversals.append(level_db)
        step = plan.steps_db[min(len(self.reversals), len(plan.steps_db) - 1)]
        self._level = min(max(level_db + direction * step, plan.lowest_db), plan.highest_db)
        self._direction = direction


def estimate_threshold(procedure: Procedure) -> ThresholdEstimate:
    """Estimate threshold and slope from the answers so far."""
    plan, answers = procedure.plan, procedure.answers
    answered = zip(procedure.shown, answers, strict=True)
    silent = [one.interval == got for one, got in answered if one.level_db is None]
    thresholds, slopes = _make_grid(plan)
    mean, low, high = _summarise(thresholds[:, 0], procedure.weights.sum(axis=1))
    if procedure.is_staircase:
        # As many peaks as valleys, all with the last step.
        late = procedure.reversals[len(plan.steps_db) - 1 :]
        late = late[len(late) % 2 :]
        mean = sum(late) / len(late) if late else math.nan
    is_beyond = low < plan.lowest_db or high > plan.highest_db
    first, caught = answers.count(1), sum(silent)
    one_sided = 2 * find_tail(max(first, len(answers) - first), len(answers)) < UNLIKELY
    notes = {
        "no threshold: too few reversals with the last step": math.isnan(mean),
        "the threshold from reversals lies outside the interval from all answers: "
        "lapses, or a change during the measurement": mean < low or mean > high,
        "the interval reaches beyond the rig's levels: the threshold may lie outside them": is_beyond,
        f"broken off: {procedure.left} trials not answered": procedure.left > 0,
        f"{caught} of {len(silent)} silent catch trials correct: the vibration may be known "
        "by something else than feeling it": find_tail(caught, len(silent)) < UNLIKELY,
        f"interval 1 answered in {first} of {len(answers)} trials": one_sided,
    }
    slope = _summarise(slopes[0], procedure.weights.sum(axis=0))
    held = tuple(note for note, holds in notes.items() if holds)
    return ThresholdEstimate(mean, low, high, *slope, len(silent), caught, is_beyond, held)


def find_tail(hits: int, trials: int) -> float:
    """Probability of so many hits or more by guessing."""
    return sum(math.comb(trials, count) for count in range(hits, trials + 1)) / (1 << trials)


def _make_grid(plan: ThresholdPlan) -> tuple[Samples, Samples]:
    """Make the thresholds, shape (n, 1), and slopes, shape (1, m), that are thought possible."""
    low, high = plan.lowest_db - MARGIN_DB, plan.highest_db + MARGIN_DB
    count = math.ceil((high - low) / THRESHOLD_STEP_DB) + 1
    return np.linspace(low, high, count)[:, None], np.geomspace(*SLOPES)[None, :]


@lru_cache(maxsize=8)
def _make_tables(plan: ThresholdPlan) -> tuple[Samples, Samples, Samples]:
    """Make the levels to choose from, (k,), and chances and entropies of an answer at them, (k, n m)."""
    count = round((plan.highest_db - plan.lowest_db) / LEVEL_STEP_DB) + 1
    levels = np.linspace(plan.lowest_db, plan.highest_db, max(count, 2))
    chances = np.stack([_predict_grid(plan, level).ravel() for level in levels])
    return levels, chances, _binary_entropy(chances)


def _predict_grid(plan: ThresholdPlan, level_db: float) -> Samples:
    """Predict the share of correct answers at a level for every threshold and slope, shape (n, m)."""
    thresholds, slopes = _make_grid(plan)
    return predict_correct(level_db, plan, threshold_db=thresholds, slope=slopes)


def _summarise(values: Samples, weights: Samples) -> tuple[float, float, float]:
    """Return mean and central 95 % interval of a discrete distribution, interpolated."""
    below = np.cumsum(weights) - weights / 2
    low, high = np.interp((0.025, 0.975), below, values)
    return float(weights @ values), float(low), float(high)


def _binary_entropy(chances: Samples) -> Samples:
    """Entropy of a yes or no of the given probability, in bits."""
    from scipy.special import entr

    chances = np.clip(chances, 0, 1)  # a mean of ones may round to more than one
    bits: Samples = (entr(chances) + entr(1 - chances)) / math.log(2)
    return bits


INTERVALS = FIRST, SECOND = ("first", "second")  # names of the parts
ASKED = "test"  # what the answer to a threshold trial is about: the vibration, in whichever interval it was


@dataclass(frozen=True, slots=True)
class ThresholdBlock:
    """The settings of a threshold block, one frequency after the other; seeds: drawn for each participant."""

    procedure: str
    frequencies_hz: tuple[float, ...]
    plan: ThresholdPlan
    duration_s: float = 0.5
    gap_s: float = 0.5
    practice: int = 3
    seeds: tuple[int, ...] = ()


def draw_block(block: ThresholdBlock, *, seed: int, number: int) -> ThresholdBlock:
    """Draw the block of participant `number` (from 1): another frequency comes first each time."""
    turn = (number - 1) % len(block.frequencies_hz)
    order = block.frequencies_hz[turn:] + block.frequencies_hz[:turn]
    seeds = np.random.default_rng([seed, number, len(order)]).integers(2**31, size=len(order))
    return replace(block, frequencies_hz=order, seeds=tuple(seeds.tolist()))


def name_tone(frequency_hz: float) -> str:
    """Name the vibration of a frequency, where a trial names its stimulus."""
    return f"{frequency_hz:g} Hz"


def make_block(block: ThresholdBlock, *, first_number: int) -> Iterator[Trial]:
    """Make the trials of a block, practice first."""
    turns = [(0, "practice")] * block.practice
    for place in range(len(block.frequencies_hz)):
        turns += [(place, THRESHOLD)] * block.plan.presentations
    names = (THRESHOLD, THRESHOLD, "strict")
    for number, (place, phase) in enumerate(turns, start=first_number):
        tone = name_tone(block.frequencies_hz[place])
        parts, judged = tuple(Part(name, tone) for name in INTERVALS), (Judgement(ASKED, tone),)
        own = place + 1 if phase == THRESHOLD else 0
        yield Trial(number, own, 0, *names, tone, parts, judged, phase=phase)


class Detection:
    """A participant's threshold block: what comes next at each frequency, and what was answered."""

    def __init__(self, block: ThresholdBlock) -> None:
        self.block = block
        self._procedures = {
            frequency: Procedure(block.procedure, replace(block.plan, seed=seed))
            for frequency, seed in zip(block.frequencies_hz, block.seeds, strict=True)
        }

    def find_frequency(self, trial: Trial) -> float:
        """Find the frequency of a trial, in Hz."""
        return {name_tone(frequency): frequency for frequency in self._procedures}[trial.recording]

    def present(self, trial: Trial) -> Presentation:
        """Return what a trial presents if it comes now."""
        if trial.phase != THRESHOLD:
            rng = np.random.default_rng([self.block.seeds[0], trial.number])
            return Presentation(int(rng.integers(1, 3)), self.block.plan.start_db)
        if (following := self._procedures[self.find_frequency(trial)].next()) is None:
            raise ValueError(f"all trials of {trial.recording} are answered, got one more")
        return following

    def tell(self, trial: Trial, values: Mapping[str, float | str]) -> None:
        """Take an answer that counts; that of practice changes nothing."""
        if trial.phase == THRESHOLD:
            answer = INTERVALS.index(str(values[ASKED])) + 1
            self._procedures[self.find_frequency(trial)].update(answer)

    def list_procedures(self) -> dict[float, Procedure]:
        """List the procedures by frequency in Hz, from the lowest."""
        return dict(sorted(self._procedures.items()))


DB_PER_POINT = 0.15
MOST_START_DB = 4.5  # the second begins up to so much weaker or stronger than in the study
MIDDLE = sum(RATING_RANGE) / 2  # marker that leaves the second as it was at first
ATTENUATION_DB = MOST_START_DB + DB_PER_POINT * (RATING_RANGE[1] - MIDDLE)


@dataclass(frozen=True, slots=True)
class MatchingBlock:
    """The settings of a matching block; starts_db: how much stronger each second is at first, for each participant."""

    level: str
    repeats: int = 1
    starts_db: tuple[float, ...] = ()


def draw_matching(
    block: MatchingBlock | None, items: Sequence[Item], *, first_number: int, key: Sequence[int]
) -> tuple[MatchingBlock | None, tuple[Trial, ...]]:
    """Draw the block of a participant, if there is one: trials in random order, and the levels at which they begin."""
    if block is None:
        return None, ()
    pairs: list[tuple[Item, Item]] = []
    for recording in dict.fromkeys(item.recording for item in items):
        own = [item for item in items if item.recording == recording]
        tests = [item for item in own if (item.role, item.level) == ("test", block.level)]
        if tests:
            reference = find_reference(tests[0], own)
            seconds = [item for item in (reference, *tests) for _ in range(block.repeats)]
            pairs += [(reference, second) for second in seconds]
    rng = np.random.default_rng(key)
    order = rng.permutation(len(pairs)).tolist()
    starts = rng.uniform(-MOST_START_DB, MOST_START_DB, len(pairs)).round(2)
    trials = []
    for number, place in enumerate(order, start=first_number):
        first, second = pairs[place]
        parts = (Part(FIRST, first.stimulus_id), Part(SECOND, second.stimulus_id))
        judged = (Judgement(SECOND, second.stimulus_id, first.stimulus_id),)
        names = (MATCHING, MATCHING, "replay", second.recording)
        trials.append(Trial(number, 1, 0, *names, parts, judged, phase=MATCHING))
    return replace(block, starts_db=tuple(starts.tolist())), tuple(trials)


class Matching:
    """A participant's matching block: how much stronger than in the study each second is played."""

    def __init__(self, block: MatchingBlock, trials: Sequence[Trial]) -> None:
        own = [trial.number for trial in trials if trial.phase == MATCHING]
        self._starts = dict(zip(own, block.starts_db, strict=True))

    def find_offset(self, trial: int, points: float = MIDDLE) -> float:
        """Find how much stronger than in the study a second is with the marker in a place, in dB."""
        return self._starts[trial] + DB_PER_POINT * (points - MIDDLE)
