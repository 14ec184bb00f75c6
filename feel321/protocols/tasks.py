"""The rating tasks: PROTOCOLS, the one list of them, what each compares, their options, and how answers are scored.

Realism judges one stimulus by itself. Similarity compares it with a reference, perhaps the real surface, to which
nothing is identical: the recording itself is a hidden reference there (Park & Kuchenbecker 2019,
doi:10.1109/WHC.2019.8816148; strict timing: Muschter et al. 2021, doi:10.1109/TOH.2021.3077191). Dissimilarity compares
all pairs, for a perceptual space (Lee et al. 2022, doi:10.1109/TOH.2022.3174229), which anchors would stretch: they are
in training only. A page of MUSHRA holds all stimuli of one recording and level (ITU-R BS.1534-3), in ABX x is a or b
again, a triplet asks which of two is more like the reference (van der Maaten & Weinberger 2012,
doi:10.1109/MLSP.2012.6349720).

A choice is scored 100 points where it is right, or where a, felt first, was chosen. Which of two comes first changes
with every turn, so that the mean over balanced trials has no advantage of the first.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from hashlib import sha256
from itertools import combinations, islice
from math import prod
from typing import Any

from feel321.arguments import Registry, check_name
from feel321.protocols.trial import (
    FREE,
    MATCHING,
    ORIGINAL,
    RATING_RANGE,
    SURFACE,
    THRESHOLD,
    Comparison,
    Item,
    Judgement,
    Part,
    Task,
    Trial,
    select_items,
)

Items = Sequence[Item]
Comparisons = tuple[Comparison, ...]
Interval = tuple[float, float]

LOWEST, HIGHEST = RATING_RANGE

EXPECTED = {"identical": (75.0, 100.0), "hidden_reference": (55.0, 100.0), "anchor": (0.0, 50.0)}
"""Catch trials: kind -> lowest and highest rating to expect, where 100 points mean that nothing is missing.

No answer is right for both a reference and an anchor, nor are two that differ by less than 5 points, so nobody passes
who always answers the same. Raters are screened in the analysis, by the limits of BS.1534-3 (90 points).
"""

RIGHT = (HIGHEST, HIGHEST)  # what is expected where only one answer is right
CHOICES = FIRST, SECOND = ("a", "b")  # names of the parts of which one is chosen
EVERY = "every"  # reference of a triplet task in which each stimulus is the reference in turn
FEWEST = 2  # stimuli of which one can be chosen
MUSHRA_MOST = 12  # stimuli on a page, the hidden reference and the anchors among them (BS.1534-3)


def count_rows(n: int) -> int:
    """Count the sequences of a Williams square of n conditions: n for even n, 2 n for odd n."""
    if n < 1:
        raise ValueError(f"n must be a number of conditions from 1, got {n}")
    return 2 * n if n % 2 and n > 1 else n


def williams_row(n: int, number: int) -> tuple[int, ...]:
    """Make one sequence of a Williams square of n conditions; number: from 0 to `count_rows(n) - 1`.

    All sequences together hold each condition at each position, and each ordered pair side by side, once for even n and
    twice for odd n (Williams 1949, doi:10.1071/CH9490149). The first zigzags 0, 1, n-1, 2, n-2, ...; the others add 1
    modulo n. With odd n, the zigzag alone favours one direction of each pair, so all are used backwards as well.

    >>> [williams_row(4, number) for number in range(count_rows(4))]
    [(0, 1, 3, 2), (1, 2, 0, 3), (2, 3, 1, 0), (3, 0, 2, 1)]
    """
    zigzag = ((place + 1) // 2 if place % 2 else -place // 2 for place in range(n))
    row = tuple((step + number) % n for step in zigzag)
    return row[::-1] if number >= n else row


def find_reference(item: Item, items: Items, *, reference: str = ORIGINAL) -> Item:
    """Find the reference of an item."""
    if reference == ORIGINAL:
        candidates = _select(items, "reference")
    else:
        candidates = [one for one in _select(items, "test") if one.reducer == reference]
    # A set may render its references once, or once per level arm; the arm's own comes first.
    own = [other for other in candidates if other.level == item.level] or candidates
    if len(own) != 1:
        raise ValueError(
            f"recording {item.recording!r}, level {item.level!r} must have exactly one stimulus for the reference "
            f"{reference!r}, got {len(own)}; build the stimulus set with it"
        )
    return own[0]


def split_arms(items: Items) -> tuple[Items, ...]:
    """Split the stimuli of a recording into its level arms: they are compared with one another inside an arm only."""
    levels = dict.fromkeys(item.level for item in _select(items, "test"))
    if not levels:
        recordings = ", ".join(dict.fromkeys(repr(item.recording) for item in items)) or "unknown"
        must = f"recording {recordings} must have at least one stimulus to test, got none"
        raise ValueError(f"{must}; name reducers and build the stimulus set again")
    return tuple(select_items(items, {"level": level}) for level in levels)


def _select(items: Items, role: str) -> list[Item]:
    return [item for item in items if item.role == role]


def _find_catch(item: Item, reference: Item | None) -> str:
    if item == reference:
        return "identical"
    if item.role == "reference" and reference is None:
        return "hidden_reference"
    return "anchor" if item.role == "anchor" else ""


def _feel_before(item: Item, items: Items, task: Task) -> tuple[Item | None, tuple[Part, ...]]:
    """Find the reference of an item, None for the real surface or where there is none, and what is felt before it."""
    if not PROTOCOLS[task.protocol].references:
        return None, ((Part(SURFACE, surface=item.recording),) if task.surface else ())
    if task.reference == SURFACE:
        return None, (Part("reference", surface=item.recording),)
    found = find_reference(item, items, reference=task.reference)
    return found, (Part("reference", found.stimulus_id),)


def _pose(
    about: str, *parts: Part, expected: Interval | None = None, catch: str = ""
) -> Comparison:
    """Ask one thing: about a part, against the part that is the reference or comes first, if there is one."""
    felt = {part.name: part.stimulus_id or SURFACE for part in parts}
    reference = felt.get("reference", felt.get("first"))
    return Comparison(parts, (Judgement(about, felt[about], reference, expected),), catch)


def arrange_pair(comparison: Comparison, turn: int) -> Comparison:
    """Let the other of two stimuli be felt first on every odd turn; a choice is about the first of them."""
    if turn % 2 == 0:
        return comparison
    *before, one, other = comparison.parts
    (asked,) = comparison.judgements
    expected = asked.expected
    if expected and asked.part in CHOICES:
        expected = (HIGHEST - expected[1], HIGHEST - expected[0])
    swapped = (replace(other, name=one.name), replace(one, name=other.name))
    return _pose(asked.part, *before, *swapped, expected=expected, catch=comparison.catch)


def compare_singly(items: Items, task: Task) -> Comparisons:
    """Judge every stimulus by itself, or compare it with its reference."""
    comparisons = []
    for item in items:
        reference, before = _feel_before(item, items, task)
        catch = _find_catch(item, reference)
        test, expected = Part("test", item.stimulus_id), EXPECTED.get(catch)
        comparisons.append(_pose("test", *before, test, expected=expected, catch=catch))
    return tuple(comparisons)


def compare_dissimilarity(items: Items, _task: Task, *, teach: bool = False) -> Comparisons:
    """Compare all pairs of the reducers and the original, within each level arm; in training, the anchors too."""
    arms = [(find_reference(arm[0], arm), arm) for arm in split_arms(items)]
    pairs = [
        (*pair, "identical" if pair[0] == pair[1] else "")
        for original, arm in arms
        for pair in [*combinations([original, *_select(arm, "test")], 2), (original, original)]
    ]
    anchors = [(one, low, "anchor") for one, arm in arms for low in _select(arm, "anchor")]
    comparisons = []
    for first, second, catch in [*pairs, *anchors] if teach else pairs:
        parts = (Part("first", first.stimulus_id), Part("second", second.stimulus_id))
        # Points of difference, where EXPECTED holds points of likeness.
        low, high = EXPECTED.get(catch, (LOWEST, HIGHEST))
        expected = (HIGHEST - high, HIGHEST - low) if catch else None
        comparisons.append(_pose("second", *parts, expected=expected, catch=catch))
    return tuple(comparisons)


def compare_mushra(items: Items, task: Task) -> Comparisons:
    """Put each level arm of a recording on one page."""
    pages = []
    for arm in split_arms(items):
        if len(arm) > MUSHRA_MOST:
            raise ValueError(
                f"recording {arm[0].recording!r}, level {arm[0].level!r}: a page of mushra must have at most "
                f"{MUSHRA_MOST} stimuli with the hidden reference and the anchors, got {len(arm)}; build a set of "
                "fewer reducers"
            )
        found, (part,) = _feel_before(arm[0], arm, task)
        about = part.stimulus_id
        judged = [
            Judgement("", item.stimulus_id, about, EXPECTED.get(_find_catch(item, found)))
            for item in arm
        ]
        pages.append(_fill_page(part, judged))
    return tuple(pages)


def arrange_mushra(comparison: Comparison, turn: int) -> Comparison:
    """Put the stimuli of a page in the order of the row of a Williams square whose turn it is."""
    judged = comparison.judgements
    row = williams_row(len(judged), turn % count_rows(len(judged)))
    return _fill_page(comparison.parts[0], (judged[place] for place in row))


def _fill_page(reference: Part, judgements: Iterable[Judgement]) -> Comparison:
    numbered = tuple(replace(j, part=str(place)) for place, j in enumerate(judgements, start=1))
    parts = (Part(judgement.part, judgement.stimulus_id) for judgement in numbered)
    return Comparison((reference, *parts), numbered)


def compare_abx(items: Items, task: Task, *, teach: bool = False) -> Comparisons:
    """Compare every stimulus of a recording with the reference of its level; in training the right answer is known."""
    comparisons = []
    for arm in split_arms(items):
        reference = find_reference(arm[0], arm, reference=task.reference)
        for item in (item for item in arm if item != reference):
            catch = _find_catch(item, reference)
            expected = RIGHT if catch or teach else None
            judgement = Judgement("x", item.stimulus_id, reference.stimulus_id, expected)
            comparisons.append(arrange_abx(Comparison((), (judgement,), catch), 0))
    return tuple(comparisons)


def arrange_abx(comparison: Comparison, turn: int) -> Comparison:
    """Make one of the four arrangements: which stimulus is a, and which of the two comes again as x."""
    (judgement,) = comparison.judgements
    pair = (judgement.stimulus_id, judgement.reference_id)[:: -1 if turn % 2 else 1]
    felt = zip((*CHOICES, "x"), (*pair, pair[turn // 2 % 2]), strict=True)
    return replace(comparison, parts=tuple(Part(name, stimulus) for name, stimulus in felt))


def compare_choices(items: Items, task: Task) -> Comparisons:
    """Compare pairs of a level arm's stimuli: by preference, or by their likeness to the reference of a triplet."""
    comparisons: list[Comparison] = []
    for arm in split_arms(items):
        tests = _select(arm, "test")
        original = find_reference(arm[0], arm) if _select(arm, "reference") else None
        felt = [original, *tests] if original else tests
        rounds: list[tuple[list[Item], tuple[Part, ...]]]
        if task.reference == EVERY:
            rounds = [
                ([item for item in felt if item != one], (Part("reference", one.stimulus_id),))
                for one in felt
            ]
        else:
            found, before = _feel_before(arm[0], arm, task)
            others = [item for item in tests if item != found]
            rounds = [(felt if task.protocol == "preference" else others, before)]
            original = found or original
        for stimuli, before in rounds:
            if len(stimuli) < FEWEST:
                raise ValueError(
                    f"a {task.protocol} must have at least two stimuli of a recording and level to choose from, got "
                    f"{len(stimuli)}; build a set of more reducers"
                )
            # Each recording and arm has pairs of its own, the same for every participant.
            about = next((p.stimulus_id or SURFACE for p in before if p.name == "reference"), None)
            key = f"{stimuli[-1].recording} {stimuli[-1].level} {about}"
            for pair in choose_pairs(len(stimuli), task.pairs, key=key):
                one, other = (stimuli[place].stimulus_id for place in pair)
                comparisons.append(_pose(FIRST, *before, Part(FIRST, one), Part(SECOND, other)))
        for place, anchor in enumerate(_select(arm, "anchor") if original else ()):
            certain = Part(FIRST, original.stimulus_id if original else None)
            parts = (*rounds[0][1], certain, Part(SECOND, anchor.stimulus_id))
            catch = _pose(FIRST, *parts, expected=RIGHT, catch="anchor")
            comparisons.append(arrange_pair(catch, place))
    return tuple(comparisons)


def choose_pairs(n: int, count: int | None, *, key: str) -> tuple[tuple[int, int], ...]:
    """Choose pairs of n things by a key, each thing in equally many or one more, all connected from n - 1 pairs on."""
    names = sorted(range(n), key=lambda place: sha256(f"{key} {place}".encode()).digest())
    pairs = ((names[one], names[other]) for one, other in _list_pairs(n))
    return tuple(sorted((min(pair), max(pair)) for pair in islice(pairs, count)))


def _list_pairs(n: int) -> Iterator[tuple[int, int]]:
    """List all pairs, so that the first ones are spread evenly over the things.

    Of an even number match by match (the circle method of tournaments); of an odd number circle by circle through all
    things, in Walecki's way, of each circle every other pair first.
    """
    last = n - 1
    if n % 2 == 0:
        for turn in range(last):
            yield last, turn
            yield from (((turn + step) % last, (turn - step) % last) for step in range(1, n // 2))
        return
    for turn in range(last // 2):
        circle = [last, *((step + turn) % last for step in williams_row(last, 0))]
        for place in (*range(0, last, 2), last, *range(1, last, 2)):
            yield circle[place], circle[(place + 1) % n]


def score_choice(
    judgement: Judgement, answer: float | str, parts: Mapping[str, str | None]
) -> float:
    """Score a choice: 100 points where the part chosen holds the stimulus of the part that is judged."""
    chosen = check_name(str(answer), CHOICES, "answer")
    return HIGHEST if parts[chosen] == parts[judgement.part] else LOWEST


@dataclass(frozen=True, slots=True)
class Protocol:
    """A rating task, as `docs/extensions.md` describes it; its name is also that of its scale.

    sure_end: the end of its slider that means the same to everybody, for the simulated observer. some_pairs: whether a
    study may ask for some of its pairs only. texts, sha256: of a lab's own, which carries its words, and its digest.
    """

    name: str
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

    def make_lessons(self, items: Items, task: Task) -> Comparisons:
        """Make the comparisons of training."""
        return (self.teach or self.compare)(items, task)


_FELT, _ANY = (ORIGINAL, "reducer"), (ORIGINAL, SURFACE, "reducer")
_RATING = Protocol("realism", compare_singly)
_CHOICE = Protocol(
    "preference", compare_choices, arrange=arrange_pair, score=score_choice, choices=CHOICES, some_pairs=True
)  # fmt: skip
_ALL = (
    _RATING,
    replace(_RATING, name="similarity", references=_ANY, sure_end=HIGHEST),
    Protocol("dissimilarity", compare_dissimilarity, references=(ORIGINAL,), arrange=arrange_pair,
             teach=partial(compare_dissimilarity, teach=True)),
    Protocol("mushra", compare_mushra, (FREE,), _FELT, arrange=arrange_mushra, sure_end=HIGHEST),
    Protocol("abx", compare_abx, references=_FELT, arrange=arrange_abx, score=score_choice, choices=CHOICES,
             teach=partial(compare_abx, teach=True)),
    replace(_CHOICE, name="triplet", references=(*_ANY, EVERY)),
    _CHOICE,
)  # fmt: skip
PROTOCOLS = Registry("protocol", {protocol.name: protocol for protocol in _ALL})
"""Name -> protocol, the only list of names. Later ones are added, none renamed."""


def digest_protocols(names: Iterable[str]) -> dict[str, str]:
    """Return the digests of those protocols that are a lab's own, as plans and journals name them."""
    return {f"protocol.{name}": own for name in names if (own := PROTOCOLS[name].sha256)}


MOST_SCALES = 4  # of a trial: more do not fit on one screen
TIMES = {"gap_s": (0.0, 30.0), "answer_timeout_s": (0.5, 600.0), "onset_s": (0.5, 600.0)}
"""The shortest and the longest time of each option, in s."""


def make_task(name: str, **options: Any) -> Task:  # noqa: ANN401 - fields of a task
    """Make a task of a protocol with options, fields of `Task`, or refuse those that it does not have.

    Left out: the protocol's first timing or reference, all pairs, the session's own silence, no limit of time.
    """
    protocol = PROTOCOLS[check_name(name, PROTOCOLS, "protocol")]
    given = {key: value for key, value in options.items() if value is not None}
    usual = {"timing": protocol.timings[0], "reference": next(iter(protocol.references), ORIGINAL)}
    task = Task(name, **{**usual, **given})
    check_name(task.timing, protocol.timings, f"tasks.{name}.timing")
    scales = () if [*task.scales] == [name] else tuple(task.scales)
    task = replace(task, scales=scales)
    faults = _list_faults(task, given.get("reference"))
    if fault := next((words for words, is_so in faults.items() if is_so), ""):
        raise ValueError(f"tasks.{name}.{fault}")
    return task


def _list_faults(task: Task, reference: str | None) -> dict[str, bool]:
    """List what could be wrong with the options of a task, and whether it is."""
    own, able, scales = task.protocol, PROTOCOLS[task.protocol].references, task.scales
    kind = reference if reference in {ORIGINAL, SURFACE, EVERY, ""} else "reducer"
    references = ", ".join(able).replace("reducer", "the name of a reducer")
    instead = f", or set reference = {SURFACE!r}" if SURFACE in able else ""
    having = [name for name, one in PROTOCOLS.items() if one.some_pairs]
    alone, is_given = "nothing is judged by itself here; leave it out", reference is not None
    none, free = "nothing is compared with a reference here", "parts are felt at will"
    faults = {
        f"reference must not be set, got {reference!r}: {none}; leave it out": is_given
        and not able,
        f"reference must be one of {references}; got {reference!r}": is_given and kind not in able,
        f"surface must be false, got true: {alone}{instead}": task.surface and bool(able),
        f"pairs must not be set, got {task.pairs}: only {' and '.join(having)} have it; leave it out": (
            task.pairs is not None and own not in having
        ),
    }
    for key, least in {"training": 0, "practice": 0, "pairs": 1}.items():
        count = getattr(task, key)
        too_few = count is not None and count < least
        faults[f"{key} must be a whole number from {least}, got {count}"] = too_few
    for key, (low, high) in TIMES.items():
        if (value := getattr(task, key)) is not None:
            faults[f"{key} must be {low:g} to {high:g}, got {value:g}"] = not low <= value <= high
            words = f"{key} must not be set: {free}, in the participant's own time; leave it out"
            faults[words] = task.timing == FREE
    own_time = "the real surface is touched, which takes its own time; leave it out"
    touches = task.surface or task.reference == SURFACE
    faults[f"onset_s must not be set where {own_time}"] = touches and task.onset_s is not None
    if not scales:
        return faults
    got = f"got {list(scales)}"
    sliders = [n for n, one in PROTOCOLS.items() if not one.choices and FREE not in one.timings]
    others = {name for name, one in PROTOCOLS.items() if not one.sha256} | {THRESHOLD, MATCHING}
    foreign = ", ".join(map(repr, sorted(others.intersection(scales) - {own})))
    too_many = len(set(scales)) < len(scales) or len(scales) > MOST_SCALES
    suited = f"several scales are for tasks with one slider ({', '.join(sliders)})"
    return faults | {
        f"scales must be left out, {got}: {suited}": own not in sliders,
        f"scales must hold {own!r}, the protocol's own, {got}; add it": own not in scales,
        f"scales must be at most {MOST_SCALES} names, each once, {got}; ask on fewer scales": too_many,
        f"scales must not hold the scale of another task, got {foreign}; name one of your own": bool(
            foreign
        ),
    }


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
