"""Tasks in which a part is chosen: which one x was (ABX), which is more like the reference, which is preferred.

Triplet: the participant feels the reference, then a and b, and says which of the two felt more like it [1]_. The pairs
are those of the reducers of one recording and level arm. Preference: a and b only, and which of them is preferred; the
recording itself is one of the stimuli. `[tasks.triplet] pairs = N` asks for N of the pairs per recording and level arm:
each stimulus is in equally many of them, as far as the number allows, and each recording has pairs of its own.

The judgement is about a, which is felt first: 100 points mean that a was chosen, 0 that b was. Which stimulus is a
changes with every turn, so that the mean over balanced trials has no advantage of the first. In catch trials one of the
two is the recording itself and the other an anchor.

References
----------
.. [1] van der Maaten, L., & Weinberger, K. (2012). Stochastic triplet embedding. IEEE International Workshop on Machine
   Learning for Signal Processing. doi:10.1109/MLSP.2012.6349720
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from hashlib import sha256
from itertools import combinations

from feel321.doors import check_name
from feel321.protocols.arms import Comparisons, Items, find_catch, find_reference, split_arms
from feel321.protocols.trial import (
    ORIGINAL,
    RATING_RANGE,
    SURFACE,
    Comparison,
    Item,
    Judgement,
    Part,
    Task,
)

ABX_CHOICES = PAIR_CHOICES = FIRST, SECOND = ("a", "b")
"""Names of the parts of which one is chosen."""

FEWEST = 2
"""Fewest stimuli of which one can be chosen."""

WRONG, RIGHT = RATING_RANGE


def compare_abx(items: Items, task: Task) -> Comparisons:
    """Compare every stimulus of a recording with the reference of its level arm."""
    comparisons = []
    for arm in split_arms(items):
        reference = find_reference(arm[0], arm, reference=task.reference)
        for item in (item for item in arm if item != reference):
            catch = find_catch(item, reference)
            expected = (RIGHT, RIGHT) if catch else None
            judgement = Judgement("x", item.stimulus_id, reference.stimulus_id, expected)
            comparisons.append(arrange_abx(Comparison((), (judgement,), catch), 0))
    return tuple(comparisons)


def teach_abx(items: Items, task: Task) -> Comparisons:
    """Make the right answer of every comparison known: x was one of the two, however hard to distinguish."""
    return tuple(
        replace(c, judgements=tuple(replace(j, expected=(RIGHT, RIGHT)) for j in c.judgements))
        for c in compare_abx(items, task)
    )


def arrange_abx(comparison: Comparison, turn: int) -> Comparison:
    """Make one of the four arrangements: which stimulus is a, and which of the two comes again as x."""
    (judgement,) = comparison.judgements
    pair = (judgement.stimulus_id, judgement.reference_id)[:: -1 if turn % 2 else 1]
    felt = zip((*ABX_CHOICES, "x"), (*pair, pair[turn // 2 % 2]), strict=True)
    return replace(comparison, parts=tuple(Part(name, stimulus) for name, stimulus in felt))


def score_abx(judgement: Judgement, answer: float | str, parts: Mapping[str, str | None]) -> float:
    """Score an ABX answer: 100 points where the part chosen holds the same stimulus as x."""
    chosen = check_name(str(answer), ABX_CHOICES, "answer")
    return RIGHT if parts[chosen] == parts[judgement.part] else WRONG


def choose_pairs(n: int, count: int | None, *, key: str) -> tuple[tuple[int, int], ...]:
    """Choose so many of the pairs of n things, in order; all of them if there are no more.

    Each thing is in equally many pairs or in one more, and chains of pairs connect all things as soon as that is
    possible (from n - 1 pairs): each next pair is of those that came least, and joins parts that nothing connects yet.
    The key decides between what is alike.
    """
    left = list(combinations(range(n), 2))
    if count is None or count >= len(left):
        return tuple(left)
    left.sort(key=lambda pair: sha256(f"{key} {pair}".encode()).digest())
    used, group = [0] * n, list(range(n))
    chosen: list[tuple[int, int]] = []
    while len(chosen) < count:
        one, other = min(
            left,
            key=lambda pair: (
                used[pair[0]] + used[pair[1]],
                abs(used[pair[0]] - used[pair[1]]),
                group[pair[0]] == group[pair[1]],
            ),
        )
        left.remove((one, other))
        chosen.append((one, other))
        used[one] += 1
        used[other] += 1
        group = [group[one] if own == group[other] else own for own in group]
    return tuple(sorted(chosen))


def compare_triplets(items: Items, task: Task) -> Comparisons:
    """Compare pairs of a level arm's stimuli by their likeness to the reference."""
    return tuple(
        comparison for arm in split_arms(items) for comparison in _judge_likeness(arm, task)
    )


def _judge_likeness(arm: Items, task: Task) -> Iterator[Comparison]:
    if task.reference == SURFACE:
        found, part = None, Part("reference", surface=arm[0].recording)
    else:
        found = find_reference(arm[0], arm, reference=task.reference)
        part = Part("reference", found.stimulus_id)
    tests = [item for item in arm if item.role == "test" and item != found]
    yield from _pair_up(tests, task, before=(part,))
    yield from _catch_out(arm, found or _find_original(arm), before=(part,))


def compare_preferences(items: Items, task: Task) -> Comparisons:
    """Compare pairs of a level arm's stimuli, the recording itself among them, by preference."""
    comparisons: list[Comparison] = []
    for arm in split_arms(items):
        original = _find_original(arm)
        tests = [item for item in arm if item.role == "test"]
        felt_first = (Part(SURFACE, surface=arm[0].recording),) if task.surface else ()
        comparisons += _pair_up([*filter(None, [original]), *tests], task, before=felt_first)
        comparisons += _catch_out(arm, original, before=felt_first)
    return tuple(comparisons)


def _find_original(arm: Items) -> Item | None:
    """Find the recording itself, which a set may lack."""
    if any(item.role == "reference" for item in arm):
        return find_reference(arm[0], arm, reference=ORIGINAL)
    return None


def _pair_up(
    stimuli: Sequence[Item], task: Task, *, before: tuple[Part, ...]
) -> Iterator[Comparison]:
    if len(stimuli) < FEWEST:
        raise ValueError(
            f"a {task.protocol} must have at least two stimuli of a recording and level to choose from, got "
            f"{len(stimuli)}; build a set of more reducers"
        )
    # Each recording and arm has pairs of its own, the same for every participant.
    key = f"{stimuli[-1].recording} {stimuli[-1].level}"
    for one, other in choose_pairs(len(stimuli), task.pairs, key=key):
        judgement = Judgement(FIRST, stimuli[one].stimulus_id, _name_reference(before))
        yield _pose(judgement, stimuli[other].stimulus_id, before=before)


def _catch_out(
    arm: Items, original: Item | None, *, before: tuple[Part, ...]
) -> Iterator[Comparison]:
    """Compare the recording itself with each anchor; which of them comes first alternates."""
    anchors = [item for item in arm if item.role == "anchor"] if original else []
    for place, anchor in enumerate(anchors):
        pair = (str(original and original.stimulus_id), anchor.stimulus_id)
        expected = (RIGHT, RIGHT)
        if place % 2:
            pair, expected = pair[::-1], (WRONG, WRONG)
        judgement = Judgement(FIRST, pair[0], _name_reference(before), expected)
        yield _pose(judgement, pair[1], before=before, catch="anchor")


def _name_reference(before: Sequence[Part]) -> str | None:
    """Name what both are compared with: nothing where a surface is only felt first."""
    return next((p.stimulus_id or SURFACE for p in before if p.name == "reference"), None)


def _pose(
    judgement: Judgement, other: str, *, before: tuple[Part, ...], catch: str = ""
) -> Comparison:
    parts = (*before, Part(FIRST, judgement.stimulus_id), Part(SECOND, other))
    return Comparison(parts, (judgement,), catch)


def arrange_pair(comparison: Comparison, turn: int) -> Comparison:
    """Let the other stimulus be felt first on every odd turn."""
    if turn % 2 == 0:
        return comparison
    (judgement,) = comparison.judgements
    *before, one, other = comparison.parts
    expected = judgement.expected
    if expected is not None:
        expected = (sum(RATING_RANGE) - expected[1], sum(RATING_RANGE) - expected[0])
    turned = replace(judgement, stimulus_id=str(other.stimulus_id), expected=expected)
    return _pose(turned, str(one.stimulus_id), before=tuple(before), catch=comparison.catch)


def score_pair(
    judgement: Judgement, answer: float | str, _parts: Mapping[str, str | None]
) -> float:
    """Score a choice: 100 points where the part that was felt first was chosen."""
    return RIGHT if check_name(str(answer), PAIR_CHOICES, "answer") == judgement.part else WRONG
