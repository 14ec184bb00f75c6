"""The rating tasks: PROTOCOLS, the one list of them, their options, and how answers are scored.

A new protocol is a `Protocol` in this module and its texts in `catalog/`; a lab's own carries its texts with it, or a
file of texts has them. What each of ours compares is described in `compare`.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import prod
from typing import Any

from feel321.doors import Registry, check_name
from feel321.protocols import compare
from feel321.protocols.compare import Comparisons, Items
from feel321.protocols.trial import (
    FREE,
    MATCHING,
    ORIGINAL,
    RATING_RANGE,
    SURFACE,
    THRESHOLD,
    Comparison,
    Judgement,
    Task,
    Trial,
)

LOWEST, HIGHEST = RATING_RANGE


@dataclass(frozen=True, slots=True)
class Protocol:
    """A rating task; the name is also that of its scale in the catalogue of texts.

    factors: in which its trials differ. compare: makes the comparisons of all items of one recording, one trial
    each. timings: its forms, of `TIMINGS`, the first by default. references: `original`, `surface`, `reducer` (any
    by name); none where judgements are absolute. teach: makes the comparisons of training: those of `compare` in
    the same order, perhaps with more known answers, then perhaps others. arrange: gives the arrangement whose turn
    (a whole number) it is, so that successive turns balance positions within a trial. score: turns an answer, with
    the ids of the parts by name, into 0 to 100 points. choices: parts to choose from; none where there is a slider.
    sure_end: the end of its slider that means the same to everybody, for the simulated observer. some_pairs: whether
    a study may ask for some of its pairs only. texts: what a lab's own carries with it: question, low_label, high_label
    and perhaps anchors of its scale, title and text of its page of instructions. sha256: digest of a lab's own code.
    """

    name: str
    factors: tuple[str, ...]
    compare: Callable[[Items, Task], Comparisons]
    timings: tuple[str, ...] = ("replay", "strict")
    references: tuple[str, ...] = ()
    teach: Callable[[Items, Task], Comparisons] | None = None
    arrange: Callable[[Comparison, int], Comparison] = lambda comparison, _: comparison
    score: Callable[[Judgement, float | str, Mapping[str, str | None]], float] = (
        lambda _judgement, answer, _parts: float(answer)
    )
    choices: tuple[str, ...] = ()
    sure_end: float = LOWEST
    some_pairs: bool = False
    texts: Mapping[str, Any] = field(default_factory=dict)
    sha256: str = ""

    @property
    def scale(self) -> str:
        """Name of its scale."""
        return self.name

    def make_lessons(self, items: Items, task: Task) -> Comparisons:
        """Make the comparisons of training."""
        return (self.teach or self.compare)(items, task)


_STIMULUS, _PAIR = ("recording", "reducer", "level"), ("recording", "pair", "level")
_CHOICE = Protocol(
    "preference",
    _PAIR,
    compare.compare_choices,
    arrange=compare.arrange_pair,
    score=compare.score_pair,
    choices=compare.CHOICES,
    some_pairs=True,
)
_ALL = (
    Protocol("realism", _STIMULUS, compare.compare_realism),
    Protocol(
        "similarity",
        _STIMULUS,
        compare.compare_similarity,
        references=(ORIGINAL, SURFACE, "reducer"),
        sure_end=HIGHEST,
    ),
    Protocol(
        "dissimilarity",
        _PAIR,
        compare.compare_dissimilarity,
        references=(ORIGINAL,),
        teach=compare.teach_dissimilarity,
        arrange=compare.arrange_dissimilarity,
    ),
    Protocol(
        "mushra",
        ("recording", "level"),
        compare.compare_mushra,
        timings=(FREE,),
        references=(ORIGINAL, "reducer"),
        arrange=compare.arrange_mushra,
        sure_end=HIGHEST,
    ),
    Protocol(
        "abx",
        _STIMULUS,
        compare.compare_abx,
        references=(ORIGINAL, "reducer"),
        teach=compare.teach_abx,
        arrange=compare.arrange_abx,
        score=compare.score_abx,
        choices=compare.CHOICES,
    ),
    replace(_CHOICE, name="triplet", references=(ORIGINAL, SURFACE, "reducer", compare.EVERY)),
    _CHOICE,
)
PROTOCOLS = Registry("protocol", {protocol.name: protocol for protocol in _ALL})
"""Name -> protocol, the only list of names. Later ones are added, none renamed."""


def digest_protocols(names: Iterable[str]) -> dict[str, str]:
    """Return the digests of those protocols that are a lab's own, as plans and journals name them."""
    return {f"protocol.{name}": own for name in names if (own := PROTOCOLS[name].sha256)}


# The options of a task.

MOST_SCALES = 4
"""Scales of a trial: more do not fit on one screen."""

TIMES = {"gap_s": (0.0, 30.0), "answer_timeout_s": (0.5, 600.0), "onset_s": (0.5, 600.0)}
"""The shortest and the longest time of each option, in s."""


def make_task(  # noqa: PLR0913 - the options that a task has
    name: str,
    *,
    timing: str | None = None,
    reference: str | None = None,
    surface: bool = False,
    training: int = 0,
    practice: int = 0,
    pairs: int | None = None,
) -> Task:
    """Make a task of a protocol.

    Parameters
    ----------
    name : str
        Name in `PROTOCOLS`.
    timing : str or None
        One of the protocol's timings; None for its first.
    reference : str or None
        The reference: `original`, `surface`, the name of a reducer, or, of triplets, `every` stimulus in turn; None
        for the protocol's first.
    surface : bool
        Whether the real surface is felt first.
    training, practice : int
        Number of trials with feedback, and of trials without feedback that do not count, before the first that does.
    pairs : int or None
        Number of pairs of each recording and level in a triplet or preference task, at least 1; None for all.

    Returns
    -------
    Task
        The task.

    Raises
    ------
    ValueError
        If there is no such protocol, or it does not have an option.

    Examples
    --------
    >>> from feel321 import protocols
    >>> protocols.make_task("similarity", reference="dft321").timing
    'replay'
    """
    protocol = PROTOCOLS[check_name(name, PROTOCOLS, "protocol")]
    timing = protocol.timings[0] if timing is None else timing
    check_name(timing, protocol.timings, f"tasks.{name}.timing")
    if reference is None:
        reference = next(iter(protocol.references), ORIGINAL)
    elif fault := _find_reference_fault(protocol, reference):
        raise ValueError(f"tasks.{name}.reference must {fault}")
    if surface and protocol.references:
        instead = f", or set reference = {SURFACE!r}" if SURFACE in protocol.references else ""
        raise ValueError(
            f"tasks.{name}.surface must be false, got true: nothing is judged by itself here; leave it out{instead}"
        )
    if pairs is not None and not protocol.some_pairs:
        having = " and ".join(name for name, other in PROTOCOLS.items() if other.some_pairs)
        raise ValueError(
            f"tasks.{name}.pairs must not be set, got {pairs}: only {having} have it; leave it out"
        )
    for key, count, least in (
        ("training", training, 0),
        ("practice", practice, 0),
        ("pairs", pairs, 1),
    ):
        if count is not None and count < least:
            raise ValueError(f"tasks.{name}.{key} must be a whole number from {least}, got {count}")
    return Task(name, timing, reference, surface, training, practice, pairs)


def _find_reference_fault(protocol: Protocol, reference: str) -> str:
    if not protocol.references:
        return f"not be set, got {reference!r}: nothing is compared with a reference here; leave it out"
    kind = reference if reference in {ORIGINAL, SURFACE, compare.EVERY} else "reducer"
    if reference and kind in protocol.references:
        return ""
    allowed = ", ".join(protocol.references).replace("reducer", "the name of a reducer")
    return f"be one of {allowed}; got {reference!r}"


def refine_task(
    task: Task,
    *,
    scales: Sequence[str] = (),
    gap_s: float | None = None,
    answer_timeout_s: float | None = None,
    onset_s: float | None = None,
) -> Task:
    """Give a task several scales, or a pace of its own; `Task` says what the options mean."""
    times = {"gap_s": gap_s, "answer_timeout_s": answer_timeout_s, "onset_s": onset_s}
    for key, value in times.items():
        place, (low, high) = f"tasks.{task.protocol}.{key}", TIMES[key]
        if value is not None and not low <= value <= high:
            raise ValueError(f"{place} must be {low:g} to {high:g}, got {value:g}")
        if value is not None and task.timing == FREE:
            raise ValueError(
                f"{place} must not be set: parts are felt at will, in the participant's own time; leave it out"
            )
    if onset_s is not None and (task.surface or task.reference == SURFACE):
        raise ValueError(
            f"tasks.{task.protocol}.onset_s must not be set where the real surface is touched, which takes its own "
            "time; leave it out"
        )
    asked = () if [*scales] == [PROTOCOLS[task.protocol].scale] else tuple(scales)
    if asked and (fault := _find_scales_fault(task, asked)):
        raise ValueError(f"tasks.{task.protocol}.scales must {fault}")
    return replace(
        task, scales=asked, gap_s=gap_s, answer_timeout_s=answer_timeout_s, onset_s=onset_s
    )


def _find_scales_fault(task: Task, scales: tuple[str, ...]) -> str:
    own, got = PROTOCOLS[task.protocol].scale, f"got {list(scales)}"
    able = [name for name, one in PROTOCOLS.items() if not one.choices and FREE not in one.timings]
    if task.protocol not in able:
        listed = ", ".join(able)
        return f"be left out, {got}: several scales are for tasks with one slider ({listed})"
    if own not in scales:
        return f"hold {own!r}, the protocol's own, {got}; add it"
    if len(set(scales)) < len(scales) or len(scales) > MOST_SCALES:
        return f"be at most {MOST_SCALES} names, each once, {got}; ask on fewer scales"
    ours = {one.scale for one in PROTOCOLS.values() if not one.sha256}
    if foreign := sorted((ours | {THRESHOLD, MATCHING}).intersection(scales) - {own}):
        names = ", ".join(map(repr, foreign))
        return f"not hold the scale of another task, got {names}; name one of your own"
    return ""


# Answers.


def score_trial(trial: Trial, values: Mapping[str, float | str]) -> dict[str, float]:
    """Score the answers to a trial: 0 to 100 points of each judgement, in the trial's order; values: by `judged`."""
    protocol = PROTOCOLS[trial.protocol]
    parts = {part.name: part.stimulus_id for part in trial.parts}
    return {j.key: protocol.score(j, values[j.key], parts) for j in trial.judgements}


def find_other(trial: Trial, judgement: Judgement) -> str | None:
    """Find the stimulus that a choice was made against; None where no part that is judged can be chosen."""
    choices = PROTOCOLS[trial.protocol].choices if trial.protocol in PROTOCOLS else ()
    if judgement.part not in choices:
        return None
    others = {*choices} - {judgement.part}
    return next(part.stimulus_id for part in trial.parts if part.name in others)


def is_as_expected(trial: Trial, values: Mapping[str, float | str]) -> bool | None:
    """Check whether all answers lie where those of someone who has understood do; None where any will do."""
    known = [(judgement.key, j) for judgement in trial.judgements if (j := judgement.expected)]
    if not known:
        return None
    points = score_trial(trial, values)
    return all(low <= points[key] <= high for key, (low, high) in known)


def measure_chance(trial: Trial) -> float:
    """Compute the probability that a guess is as expected."""
    if choices := PROTOCOLS[trial.protocol].choices:
        return 1 / len(choices)
    known = [judgement.expected for judgement in trial.judgements if judgement.expected]
    return prod((most - least) / (HIGHEST - LOWEST) for least, most in known)
