"""The rating tasks: what each compares and how it is scored, PROTOCOLS, the one list of them, and `make_task`.

A new protocol is a `Protocol` in this module and its texts in `catalog/`; a lab's own carries its texts with it, or a
file of texts has them. Triplets and preferences are described in `choosing`.

Realism: one stimulus, from not at all real to like the real surface, which may be stroked first. Every stimulus is
judged by itself, the recording's own vibration and the anchors among them.

Similarity: a reference, then a stimulus; 100 points mean identical. The reference is the recording itself, the real
surface, or what a reducer made of the recording [1]_. The reference is judged against itself too: a participant who
feels a difference there is caught. Nothing is identical to the real surface; there the recording itself is the hidden
reference. Parts may be felt again unless a study asks for strict timing, as in [2]_.

Dissimilarity: two stimuli; 0 points mean identical. All pairs of the reducers and the recording itself are judged, so
that multidimensional scaling can draw the space in which they differ [3]_. One more pair holds the recording itself
twice, as a catch trial. Anchors would stretch the space; they appear in training only, where they are what certainly
differs from the recording. Which of the two comes first changes with every turn.

MUSHRA: many stimuli on one page, each with a slider, and a reference that is named as such [4]_. The participant
switches freely between them; 100 points mean just like the reference. Among them are, unnamed, the reference itself
and two anchors that were made to be rated badly. A low-pass is no anchor below 1 kHz, so a stimulus set brings haptic
ones; [2]_ brought the method to vibrations. A page holds one level arm of one recording.

ABX: the participant feels a, b and x, and says which of the first two x was. One of a and b is a stimulus, the other
its reference; x is one of them again. 100 points mean right, 0 wrong, so that the mean over trials is the percentage
correct: 50 for someone who feels no difference. This is the task behind "not perceptibly different" [5]_. Everyone
who has understood it distinguishes an anchor from the reference.

References
----------
.. [1] Park, G., & Kuchenbecker, K. J. (2019). Objective and subjective assessment of algorithms for reducing
   three-axis vibrations to one-axis vibrations. IEEE World Haptics Conference. doi:10.1109/WHC.2019.8816148
.. [2] Muschter, E., et al. (2021). Perceptual quality assessment of compressed vibrotactile signals through comparative
   judgment. IEEE Transactions on Haptics, 14(2). doi:10.1109/TOH.2021.3077191
.. [3] Lee, H., Tombak, G. I., Park, G., & Kuchenbecker, K. J. (2022). Perceptual space of algorithms for three-to-one
   dimensional reduction of realistic vibrations. IEEE Transactions on Haptics, 15(3). doi:10.1109/TOH.2022.3174229
.. [4] ITU-R BS.1534-3, "Method for the subjective assessment of intermediate quality level of audio systems", 2015.
.. [5] Macmillan, N. A., & Creelman, C. D. (2005). Detection theory: A user's guide (2nd ed.), chapter 9.
   doi:10.4324/9781410611147
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from math import prod
from typing import Any

from feel321.doors import Registry, check_name
from feel321.protocols import choosing
from feel321.protocols.arms import (
    EXPECTED,
    Comparisons,
    Items,
    find_catch,
    find_reference,
    split_arms,
)
from feel321.protocols.balance import williams_square
from feel321.protocols.trial import (
    FREE,
    ORIGINAL,
    RATING_RANGE,
    SURFACE,
    Comparison,
    Judgement,
    Part,
    Task,
    Trial,
)


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
    sure_end: float = RATING_RANGE[0]
    some_pairs: bool = False
    texts: Mapping[str, Any] = field(default_factory=dict)
    sha256: str = ""

    @property
    def scale(self) -> str:
        """Name of its scale."""
        return self.name

    @property
    def has_slider(self) -> bool:
        """Whether a trial has one slider, beside which there may be others."""
        return not self.choices and FREE not in self.timings

    def make_lessons(self, items: Items, task: Task) -> Comparisons:
        """Make the comparisons of training."""
        return (self.teach or self.compare)(items, task)


def _compare_realism(items: Items, task: Task) -> Comparisons:
    comparisons = []
    for item in items:
        felt_first = (Part(SURFACE, surface=item.recording),) if task.surface else ()
        catch = find_catch(item, None)
        judgement = Judgement("test", item.stimulus_id, expected=EXPECTED.get(catch))
        parts = (*felt_first, Part("test", item.stimulus_id))
        comparisons.append(Comparison(parts, (judgement,), catch))
    return tuple(comparisons)


def _compare_similarity(items: Items, task: Task) -> Comparisons:
    comparisons = []
    for item in items:
        if task.reference == SURFACE:
            found, first = None, Part("reference", surface=item.recording)
        else:
            found = find_reference(item, items, reference=task.reference)
            first = Part("reference", found.stimulus_id)
        catch = find_catch(item, found)
        about = first.stimulus_id or SURFACE
        judgement = Judgement("test", item.stimulus_id, about, EXPECTED.get(catch))
        comparisons.append(Comparison((first, Part("test", item.stimulus_id)), (judgement,), catch))
    return tuple(comparisons)


def _compare_dissimilarity(items: Items, _task: Task) -> Comparisons:
    """Compare all pairs of the reducers and the original, within each level arm."""
    comparisons = []
    for arm in split_arms(items):
        original = find_reference(arm[0], arm, reference=ORIGINAL).stimulus_id
        names = [original, *(item.stimulus_id for item in arm if item.role == "test")]
        comparisons += [_make_pair(first, second) for first, second in combinations(names, 2)]
        comparisons.append(_make_pair(original, original, catch="identical"))
    return tuple(comparisons)


def _teach_dissimilarity(items: Items, task: Task) -> Comparisons:
    """Show also how the anchors differ from the original."""
    anchors = [(arm, item) for arm in split_arms(items) for item in arm if item.role == "anchor"]
    references = [find_reference(item, arm, reference=ORIGINAL) for arm, item in anchors]
    obvious = (
        _make_pair(reference.stimulus_id, item.stimulus_id, catch="anchor")
        for (_, item), reference in zip(anchors, references, strict=True)
    )
    return (*_compare_dissimilarity(items, task), *obvious)


def _arrange_dissimilarity(comparison: Comparison, turn: int) -> Comparison:
    """Put the other stimulus first on every odd turn."""
    first, second = (str(part.stimulus_id) for part in comparison.parts)
    return _make_pair(second, first, catch=comparison.catch) if turn % 2 else comparison


def _make_pair(first: str, second: str, *, catch: str = "") -> Comparison:
    expected = None
    if catch:  # points of difference, where EXPECTED holds points of likeness
        lowest, highest = EXPECTED[catch]
        expected = sum(RATING_RANGE) - highest, sum(RATING_RANGE) - lowest
    judgement = Judgement("second", second, first, expected)
    return Comparison((Part("first", first), Part("second", second)), (judgement,), catch)


MUSHRA_MOST = 12
"""Most stimuli on a page of MUSHRA, the hidden reference and the anchors among them (BS.1534-3)."""


def _compare_mushra(items: Items, task: Task) -> Comparisons:
    """Put each level arm of a recording on one page."""
    return tuple(_make_page(arm, reference=task.reference) for arm in split_arms(items))


def _make_page(arm: Items, *, reference: str) -> Comparison:
    if len(arm) > MUSHRA_MOST:
        raise ValueError(
            f"recording {arm[0].recording!r}, level {arm[0].level!r}: a page of mushra must have at most {MUSHRA_MOST} "
            f"stimuli with the hidden reference and the anchors, got {len(arm)}; build a set of fewer reducers"
        )
    found = find_reference(arm[0], arm, reference=reference)
    judgements = [
        Judgement("", item.stimulus_id, found.stimulus_id, EXPECTED.get(find_catch(item, found)))
        for item in arm
    ]
    return _fill_page(Part("reference", found.stimulus_id), judgements)


def _arrange_mushra(comparison: Comparison, turn: int) -> Comparison:
    """Put the stimuli of a page in the order of the row of a Williams square whose turn it is."""
    square = williams_square(len(comparison.judgements))
    row = square[turn % len(square)]
    return _fill_page(comparison.parts[0], [comparison.judgements[place] for place in row])


def _fill_page(reference: Part, judgements: Sequence[Judgement]) -> Comparison:
    numbered = tuple(replace(j, part=str(place)) for place, j in enumerate(judgements, start=1))
    parts = (Part(judgement.part, judgement.stimulus_id) for judgement in numbered)
    return Comparison((reference, *parts), numbered)


_STIMULUS = ("recording", "reducer", "level")
_ALL = (
    Protocol("realism", _STIMULUS, _compare_realism),
    Protocol(
        "similarity",
        _STIMULUS,
        _compare_similarity,
        references=(ORIGINAL, SURFACE, "reducer"),
        sure_end=RATING_RANGE[1],
    ),
    Protocol(
        "dissimilarity",
        ("recording", "pair", "level"),
        _compare_dissimilarity,
        references=(ORIGINAL,),
        teach=_teach_dissimilarity,
        arrange=_arrange_dissimilarity,
    ),
    Protocol(
        "mushra",
        ("recording", "level"),
        _compare_mushra,
        timings=(FREE,),
        references=(ORIGINAL, "reducer"),
        arrange=_arrange_mushra,
        sure_end=RATING_RANGE[1],
    ),
    Protocol(
        "abx",
        _STIMULUS,
        choosing.compare_abx,
        references=(ORIGINAL, "reducer"),
        teach=choosing.teach_abx,
        arrange=choosing.arrange_abx,
        score=choosing.score_abx,
        choices=choosing.ABX_CHOICES,
    ),
    Protocol(
        "triplet",
        ("recording", "pair", "level"),
        choosing.compare_triplets,
        references=(ORIGINAL, SURFACE, "reducer", choosing.EVERY),
        arrange=choosing.arrange_pair,
        score=choosing.score_pair,
        choices=choosing.PAIR_CHOICES,
        some_pairs=True,
    ),
    Protocol(
        "preference",
        ("recording", "pair", "level"),
        choosing.compare_preferences,
        arrange=choosing.arrange_pair,
        score=choosing.score_pair,
        choices=choosing.PAIR_CHOICES,
        some_pairs=True,
    ),
)
PROTOCOLS = Registry("protocol", {protocol.name: protocol for protocol in _ALL})
"""Name -> protocol, the only list of names. Later ones are added, none renamed."""


def digest_protocols(names: Iterable[str]) -> dict[str, str]:
    """Return the digests of those protocols that are a lab's own, as plans and journals name them."""
    return {f"protocol.{name}": own for name in names if (own := PROTOCOLS[name].sha256)}


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
    if timing is None:
        timing = protocol.timings[0]
    check_name(timing, protocol.timings, f"tasks.{name}.timing")
    if reference is None:
        reference = next(iter(protocol.references), ORIGINAL)
    else:
        _check_reference(protocol, reference)
    if surface and protocol.references:
        instead = f", or set reference = {SURFACE!r}" if SURFACE in protocol.references else ""
        raise ValueError(
            f"tasks.{name}.surface must be false, got true: nothing is judged by itself here; leave it out{instead}"
        )
    for key, count in {"training": training, "practice": practice}.items():
        if count < 0:
            raise ValueError(f"tasks.{name}.{key} must be a whole number from 0, got {count}")
    _check_pairs(protocol, pairs)
    return Task(name, timing, reference, surface, training, practice, pairs)


def _check_pairs(protocol: Protocol, pairs: int | None) -> None:
    key = f"tasks.{protocol.name}.pairs"
    if pairs is not None and not protocol.some_pairs:
        having = " and ".join(name for name, other in PROTOCOLS.items() if other.some_pairs)
        raise ValueError(f"{key} must not be set, got {pairs}: only {having} have it; leave it out")
    if pairs is not None and pairs < 1:
        raise ValueError(f"{key} must be a whole number from 1, got {pairs}")


def _check_reference(protocol: Protocol, reference: str) -> None:
    key = f"tasks.{protocol.name}.reference"
    if not protocol.references:
        raise ValueError(
            f"{key} must not be set, got {reference!r}: nothing is compared with a reference here; leave it out"
        )
    kind = reference if reference in {ORIGINAL, SURFACE, choosing.EVERY} else "reducer"
    if not reference or kind not in protocol.references:
        allowed = ", ".join(protocol.references).replace("reducer", "the name of a reducer")
        raise ValueError(f"{key} must be one of {allowed}; got {reference!r}")


def score_trial(trial: Trial, values: Mapping[str, float | str]) -> dict[str, float]:
    """Score the answers to a trial.

    Parameters
    ----------
    trial : Trial
        The trial.
    values : mapping of str to float or str
        The answer to each of its judgements, by the part that is judged.

    Returns
    -------
    dict of str to float
        Points, 0 to 100, by the part that is judged (and the scale), in the trial's order.

    Raises
    ------
    KeyError
        If a judgement has no answer.

    Examples
    --------
    >>> from feel321 import protocols
    >>> oak = [
    ...     protocols.Item("oak-original", "oak", "original", "as_is", "reference"),
    ...     protocols.Item("oak-dft321", "oak", "dft321", "as_is", "test"),
    ... ]
    >>> (trial,) = protocols.make_order(oak, ["abx"], number=1)
    >>> [part.stimulus_id for part in trial.parts]
    ['oak-original', 'oak-dft321', 'oak-original']
    >>> protocols.score_trial(trial, {"x": "a"})
    {'x': 100.0}
    """
    protocol = PROTOCOLS[trial.protocol]
    parts = {part.name: part.stimulus_id for part in trial.parts}
    return {j.key: protocol.score(j, values[j.key], parts) for j in trial.judgements}


def find_other(trial: Trial, judgement: Judgement) -> str | None:
    """Find the stimulus that a choice was made against; None where no part that is judged can be chosen."""
    protocol = PROTOCOLS.get(trial.protocol)
    others = {*(protocol.choices if protocol else ())} - {judgement.part}
    if protocol is None or judgement.part not in protocol.choices:
        return None
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
    low, high = RATING_RANGE
    known = [judgement.expected for judgement in trial.judgements if judgement.expected]
    return prod((most - least) / (high - low) for least, most in known)
