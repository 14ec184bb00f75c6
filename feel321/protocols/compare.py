"""What each protocol compares: the trials that the stimuli of one recording make, and their catch trials.

- *Realism*: one stimulus, from not at all real to like the real surface, which may be stroked first. Every stimulus is
  judged by itself, the recording's own vibration and the anchors among them.
- *Similarity*: a reference, then a stimulus; 100 points mean identical. The reference is the recording itself, the real
  surface, or what a reducer made of the recording [1]_; it is judged against itself too. Nothing is identical to the
  real surface; there the recording itself is the hidden reference. Strict timing is that of [2]_.
- *Dissimilarity*: two stimuli; 0 points mean identical. All pairs of the reducers and the recording itself are judged,
  so that multidimensional scaling can draw the space in which they differ [3]_, and the recording itself against
  itself. Anchors would stretch the space; they appear in training only, where they are what certainly differs.
- *MUSHRA*: a page holds one level arm of one recording, each stimulus with a slider, and a reference that is named as
  such [4]_. Among them are, unnamed, the reference itself and anchors that were made to be rated badly: haptic ones,
  for a low-pass is no anchor below 1 kHz ([2]_ brought the method to vibrations).
- *ABX*: a and b are a stimulus and its reference, x is one of them again. 100 points mean right, so that the mean is
  the percentage correct: 50 for someone who feels no difference [5]_.
- *Triplet*: the reference, then a and b, which of the two felt more like it [6]_: pairs of the reducers of one
  recording and level arm. With `reference = "every"` each of them and the recording itself is the reference in turn.
- *Preference*: which of a and b is preferred; the recording itself is one of the stimuli.

Of the last two, `pairs = N` asks for N of the pairs per recording, level arm and reference. Their judgement is about a,
which is felt first: 100 points mean that a was chosen, 0 that b was. In catch trials one of the two is the recording
itself and the other an anchor. In every protocol, which of two comes first changes with every turn, so that the mean
over balanced trials has no advantage of the first.

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
.. [6] van der Maaten, L., & Weinberger, K. (2012). Stochastic triplet embedding. IEEE International Workshop on Machine
   Learning for Signal Processing. doi:10.1109/MLSP.2012.6349720
.. [7] Williams, E. J. (1949). Experimental designs balanced for the estimation of residual effects of
   treatments. Australian Journal of Scientific Research A, 2, 149-168. doi:10.1071/CH9490149
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from hashlib import sha256
from itertools import combinations, islice
from types import MappingProxyType

from feel321.doors import check_name
from feel321.protocols.trial import (
    ORIGINAL,
    RATING_RANGE,
    SURFACE,
    Comparison,
    Item,
    Judgement,
    Part,
    Task,
    select_items,
)

Items = Sequence[Item]
Comparisons = tuple[Comparison, ...]

WRONG, RIGHT = RATING_RANGE

EXPECTED: Mapping[str, tuple[float, float]] = MappingProxyType({
    "identical": (75.0, 100.0),
    "hidden_reference": (55.0, 100.0),
    "anchor": (0.0, 50.0),
})
"""Catch trials: kind -> lowest and highest rating to expect, where 100 points mean that nothing is missing.

The reference against itself is *identical*, the recording judged by itself or against the real surface a *hidden
reference*; *anchors* should be rated 50 or lower, the better of two as well, so none needs to be known by name. The
limits say whether a task was understood, no more: the upper quarter of the scale is for what is as good as the
reference. No answer is right for both a reference and an anchor, nor are two that differ by less than 5 points, so
nobody passes who always answers the same. Raters are screened in the analysis, by the limits of BS.1534-3 (90 points).
"""

CHOICES = FIRST, SECOND = ("a", "b")
"""Names of the parts of which one is chosen."""

EVERY = "every"
"""Reference of a triplet task in which each stimulus is the reference in turn."""

FEWEST = 2
"""Fewest stimuli of which one can be chosen."""

MUSHRA_MOST = 12
"""Most stimuli on a page of MUSHRA, the hidden reference and the anchors among them (BS.1534-3)."""


def count_rows(n: int) -> int:
    """Count the sequences of a Williams square of n conditions: n for even n, 2 n for odd n."""
    if n < 1:
        raise ValueError(f"n must be a number of conditions from 1, got {n}")
    return 2 * n if n % 2 and n > 1 else n


def williams_row(n: int, number: int) -> tuple[int, ...]:
    """Make one sequence of a Williams square of n conditions [7]_; number: from 0 to `count_rows(n) - 1`.

    In all sequences together each condition is at each position, and each ordered pair of conditions is adjacent,
    once for even n and twice for odd n. The first sequence zigzags 0, 1, n-1, 2, n-2, ...; the others add 1 modulo n.
    With odd n, the zigzag alone favours one direction of each pair, so every sequence is used backwards as well.

    Examples
    --------
    >>> [williams_row(4, number) for number in range(count_rows(4))]
    [(0, 1, 3, 2), (1, 2, 0, 3), (2, 3, 1, 0), (3, 0, 2, 1)]
    """
    shift = number % n
    zigzag = ((place + 1) // 2 if place % 2 else -place // 2 for place in range(n))
    row = tuple((step + shift) % n for step in zigzag)
    return row[::-1] if number >= n else row


# What is compared with what.


def find_catch(item: Item, reference: Item | None) -> str:
    """Find the kind of catch trial that a stimulus makes beside its reference; empty for none."""
    if item == reference:
        return "identical"
    if item.role == "reference" and reference is None:
        return "hidden_reference"
    return "anchor" if item.role == "anchor" else ""


def find_reference(item: Item, items: Items, *, reference: str = ORIGINAL) -> Item:
    """Find the reference of an item."""
    if reference == ORIGINAL:
        candidates = [other for other in items if other.role == "reference"]
    else:
        candidates = [o for o in items if o.reducer == reference and o.role == "test"]
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
    levels = dict.fromkeys(item.level for item in items if item.role == "test")
    if not levels:
        recordings = ", ".join(dict.fromkeys(repr(item.recording) for item in items)) or "unknown"
        raise ValueError(
            f"recording {recordings} must have at least one stimulus to test, got none; "
            "name reducers and build the stimulus set again"
        )
    return tuple(select_items(items, {"level": level}) for level in levels)


def _select(items: Items, role: str) -> list[Item]:
    return [item for item in items if item.role == role]


def _feel_reference(item: Item, items: Items, task: Task) -> tuple[Item | None, Part]:
    """Find what an item is compared with, None for the real surface, and the part in which it is felt."""
    if task.reference == SURFACE:
        return None, Part("reference", surface=item.recording)
    found = find_reference(item, items, reference=task.reference)
    return found, Part("reference", found.stimulus_id)


def _touch_first(recording: str, task: Task) -> tuple[Part, ...]:
    return (Part(SURFACE, surface=recording),) if task.surface else ()


# Sliders.


def compare_realism(items: Items, task: Task) -> Comparisons:
    """Judge every stimulus by itself."""
    comparisons = []
    for item in items:
        catch = find_catch(item, None)
        judgement = Judgement("test", item.stimulus_id, expected=EXPECTED.get(catch))
        parts = (*_touch_first(item.recording, task), Part("test", item.stimulus_id))
        comparisons.append(Comparison(parts, (judgement,), catch))
    return tuple(comparisons)


def compare_similarity(items: Items, task: Task) -> Comparisons:
    """Compare every stimulus with its reference."""
    comparisons = []
    for item in items:
        found, first = _feel_reference(item, items, task)
        catch = find_catch(item, found)
        about = first.stimulus_id or SURFACE
        judgement = Judgement("test", item.stimulus_id, about, EXPECTED.get(catch))
        comparisons.append(Comparison((first, Part("test", item.stimulus_id)), (judgement,), catch))
    return tuple(comparisons)


def compare_dissimilarity(items: Items, _task: Task) -> Comparisons:
    """Compare all pairs of the reducers and the original, within each level arm."""
    comparisons = []
    for arm in split_arms(items):
        felt = [find_reference(arm[0], arm), *_select(arm, "test")]
        names = [item.stimulus_id for item in felt]
        comparisons += [_pose_difference(*pair) for pair in combinations(names, 2)]
        comparisons.append(_pose_difference(names[0], names[0], catch="identical"))
    return tuple(comparisons)


def teach_dissimilarity(items: Items, task: Task) -> Comparisons:
    """Show also how the anchors differ from the original."""
    obvious = [
        _pose_difference(find_reference(item, arm).stimulus_id, item.stimulus_id, catch="anchor")
        for arm in split_arms(items)
        for item in _select(arm, "anchor")
    ]
    return (*compare_dissimilarity(items, task), *obvious)


def arrange_dissimilarity(comparison: Comparison, turn: int) -> Comparison:
    """Put the other stimulus first on every odd turn."""
    first, second = (str(part.stimulus_id) for part in comparison.parts)
    return _pose_difference(second, first, catch=comparison.catch) if turn % 2 else comparison


def _pose_difference(first: str, second: str, *, catch: str = "") -> Comparison:
    # Points of difference, where EXPECTED holds points of likeness.
    expected = _turn_over(EXPECTED[catch]) if catch else None
    judgement = Judgement("second", second, first, expected)
    return Comparison((Part("first", first), Part("second", second)), (judgement,), catch)


def _turn_over(expected: tuple[float, float]) -> tuple[float, float]:
    lowest, highest = expected
    return sum(RATING_RANGE) - highest, sum(RATING_RANGE) - lowest


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
        found, part = _feel_reference(arm[0], arm, task)
        judgements = [
            Judgement("", item.stimulus_id, part.stimulus_id, EXPECTED.get(find_catch(item, found)))
            for item in arm
        ]
        pages.append(_fill_page(part, judgements))
    return tuple(pages)


def arrange_mushra(comparison: Comparison, turn: int) -> Comparison:
    """Put the stimuli of a page in the order of the row of a Williams square whose turn it is."""
    count = len(comparison.judgements)
    row = williams_row(count, turn % count_rows(count))
    return _fill_page(comparison.parts[0], [comparison.judgements[place] for place in row])


def _fill_page(reference: Part, judgements: Sequence[Judgement]) -> Comparison:
    numbered = tuple(replace(j, part=str(place)) for place, j in enumerate(judgements, start=1))
    parts = (Part(judgement.part, judgement.stimulus_id) for judgement in numbered)
    return Comparison((reference, *parts), numbered)


# Choices.


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
    felt = zip((*CHOICES, "x"), (*pair, pair[turn // 2 % 2]), strict=True)
    return replace(comparison, parts=tuple(Part(name, stimulus) for name, stimulus in felt))


def score_abx(judgement: Judgement, answer: float | str, parts: Mapping[str, str | None]) -> float:
    """Score an ABX answer: 100 points where the part chosen holds the same stimulus as x."""
    chosen = check_name(str(answer), CHOICES, "answer")
    return RIGHT if parts[chosen] == parts[judgement.part] else WRONG


def compare_choices(items: Items, task: Task) -> Comparisons:
    """Compare pairs of a level arm's stimuli: by preference, or by their likeness to the reference of a triplet."""
    comparisons: list[Comparison] = []
    for arm in split_arms(items):
        original = find_reference(arm[0], arm) if _select(arm, "reference") else None
        tests = _select(arm, "test")
        felt = [*filter(None, [original]), *tests]
        if task.protocol == "preference":
            before = _touch_first(arm[0].recording, task)
            comparisons += _pair_up(felt, task, before=before)
        elif task.reference == EVERY:
            # Each test stimulus and the recording itself is the reference in turn, of pairs of the others.
            for reference in felt:
                others = [item for item in felt if item != reference]
                part = Part("reference", reference.stimulus_id)
                comparisons += _pair_up(others, task, before=(part,))
            before = (Part("reference", original.stimulus_id if original else ""),)
        else:
            found, part = _feel_reference(arm[0], arm, task)
            before = (part,)
            comparisons += _pair_up([t for t in tests if t != found], task, before=before)
            original = found or original
        for place, anchor in enumerate(_select(arm, "anchor") if original else ()):
            pair = (original.stimulus_id if original else "", anchor.stimulus_id)
            catch = _pose_choice(*pair, before=before, expected=(RIGHT, RIGHT), catch="anchor")
            comparisons.append(arrange_pair(catch, place))
    return tuple(comparisons)


def _pair_up(
    stimuli: Sequence[Item], task: Task, *, before: tuple[Part, ...]
) -> Iterator[Comparison]:
    if len(stimuli) < FEWEST:
        raise ValueError(
            f"a {task.protocol} must have at least two stimuli of a recording and level to choose from, got "
            f"{len(stimuli)}; build a set of more reducers"
        )
    # Each recording and arm has pairs of its own, the same for every participant.
    key = f"{stimuli[-1].recording} {stimuli[-1].level} {_name_reference(before)}"
    for one, other in choose_pairs(len(stimuli), task.pairs, key=key):
        yield _pose_choice(stimuli[one].stimulus_id, stimuli[other].stimulus_id, before=before)


def _name_reference(before: Sequence[Part]) -> str | None:
    """Name what both are compared with: nothing where a surface is only felt first."""
    return next((p.stimulus_id or SURFACE for p in before if p.name == "reference"), None)


def _pose_choice(
    one: str,
    other: str,
    *,
    before: tuple[Part, ...],
    expected: tuple[float, float] | None = None,
    catch: str = "",
) -> Comparison:
    judgement = Judgement(FIRST, one, _name_reference(before), expected)
    return Comparison((*before, Part(FIRST, one), Part(SECOND, other)), (judgement,), catch)


def arrange_pair(comparison: Comparison, turn: int) -> Comparison:
    """Let the other stimulus be felt first on every odd turn."""
    if turn % 2 == 0:
        return comparison
    (judgement,) = comparison.judgements
    *before, one, other = comparison.parts
    return _pose_choice(
        str(other.stimulus_id),
        str(one.stimulus_id),
        before=tuple(before),
        expected=judgement.expected and _turn_over(judgement.expected),
        catch=comparison.catch,
    )


def score_pair(
    judgement: Judgement, answer: float | str, _parts: Mapping[str, str | None]
) -> float:
    """Score a choice: 100 points where the part that was felt first was chosen."""
    return RIGHT if check_name(str(answer), CHOICES, "answer") == judgement.part else WRONG


def choose_pairs(n: int, count: int | None, *, key: str) -> tuple[tuple[int, int], ...]:
    """Choose so many of the pairs of n things, in order; all of them if there are no more.

    Each thing is in equally many pairs or in one more, and chains of pairs connect all things as soon as that is
    possible (from n - 1 pairs). The key decides which thing has which place.
    """
    names = sorted(range(n), key=lambda place: sha256(f"{key} {place}".encode()).digest())
    pairs = ((names[one], names[other]) for one, other in _list_pairs(n))
    return tuple(sorted((min(pair), max(pair)) for pair in islice(pairs, count)))


def _list_pairs(n: int) -> Iterator[tuple[int, int]]:
    """List all pairs, so that the first ones are spread evenly over the things.

    Of an even number match by match, each thing in each match once (the circle method of tournaments; two matches in a
    row make one circle through all things). Of an odd number circle by circle through all of them, in Walecki's way: of
    each circle every other pair comes first, then the one with the thing that was left over, then the others.
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
