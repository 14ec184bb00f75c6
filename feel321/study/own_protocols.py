"""A lab's own protocols: found, checked, called under guard, and put beside feel321's while a study is open.

`PROTOCOLS` is looked up by name from many places, so a study's own protocols are added to it when its settings are
read. Two studies of one process whose protocols have one name must take turns: the last that was read has it.
"""

import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from feel321.arguments import describe
from feel321.extensions import Method, call, find_method, is_given
from feel321.files import read_small
from feel321.protocols.tasks import PROTOCOLS, Comparisons, Items, Protocol
from feel321.protocols.trial import (
    MATCHING,
    RATING_RANGE,
    SURFACE,
    THRESHOLD,
    TIMINGS,
    Comparison,
    Judgement,
    Part,
    Task,
)

# Names of feel321's own protocols.
OURS = tuple(name for name, one in PROTOCOLS.items() if not one.sha256)

WORDS = ("question", "low_label", "high_label")
PAGE = ("title", "text")
CATCHES = ("", "identical", "hidden_reference", "anchor")


def name_protocols(given: object) -> list[str]:
    """Name those of a list of protocols that are the lab's own, by their short names."""
    listed = given if isinstance(given, list | tuple) else []
    own = [one for one in listed if isinstance(one, str) and one not in OURS]
    return [one.rpartition(":")[2] for one in own if is_given("protocol", one)]


def admit_protocols(given: Sequence[str], folder: Path) -> tuple[str, ...]:
    """Load a study's own protocols and put them beside feel321's; returns the short names of all."""
    names = tuple(name if name in OURS else _admit(name, folder) for name in given)
    if doubled := sorted({name for name in names if names.count(name) > 1}):
        must = "session.protocols must hold each name once"
        raise ValueError(f"{must}; more than once: {', '.join(doubled)}")
    return names


def require_protocols(path: Path, names: Sequence[str], digests: Mapping[str, str]) -> None:
    """Admit the lab's own protocols of a stored plan, for verbs that read journals only."""
    own = {name: digests.get(f"protocol.{name}") for name in names if name not in OURS}
    if all(name in PROTOCOLS and PROTOCOLS[name].sha256 == own[name] for name in own):
        return
    settings = path.parents[2] / "study.toml"
    try:
        given = tomllib.loads(read_small(settings))["session"]["protocols"]
        admit_protocols([one for one in given if one.rpartition(":")[2] in own], settings.parent)
    except (OSError, LookupError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"{path}: {', '.join(own)} cannot be opened: {error}") from None
    if lost := [name for name in own if name not in PROTOCOLS]:
        what = f"{path}: protocol {', '.join(lost)} is not in session.protocols of {settings.name}"
        raise ValueError(f"{what}; name it there again")


def add_texts(texts: dict[str, Any], names: Sequence[str]) -> None:
    """Add the texts that the lab's own protocols carry."""
    for name in names:
        protocol = PROTOCOLS[name]
        if not protocol.sha256:
            continue
        page = f"instructions.{name}"
        own = dict(protocol.texts)
        scale = {key: own[key] for key in (*WORDS, "anchors") if key in own}
        given = texts["scales"].get(name) or scale  # the study's own [scales.NAME] come first
        shown = {key: own[key] for key in PAGE if key in own}
        if missing := ", ".join(key for key in (*WORDS, *PAGE) if key not in given | shown):
            what = f"protocol {name} has no {missing}"
            raise ValueError(f"{what}; give texts={{...}} to its Protocol")
        choices = {"choices": list(protocol.choices)} if protocol.choices else {}
        texts["scales"][name] = {**given, **choices}
        texts["pages"][page] = shown


def _admit(given: str, folder: Path) -> str:
    method = find_method("protocol", given, taken=(*OURS, THRESHOLD, MATCHING), folder=folder)
    found = method.load()
    if not isinstance(found, Protocol):
        must = f"{method}: must be a feel321.protocols.tasks.Protocol, got {describe(found)}"
        raise TypeError(f"{must}; make one of it")
    if fault := next(_find_protocol_faults(found, method.name), ""):
        raise ValueError(f"{method}: {fault}")
    own, teach = partial(_compare, method=method), found.teach
    # The lab's functions are called as all of its code is, and what they return is checked.
    guarded = replace(
        found,
        compare=partial(own, function=found.compare, doing="comparing"),
        teach=teach and partial(own, function=teach, doing="making its training"),
        arrange=partial(_arrange, method=method, function=found.arrange),
        score=partial(_score, method=method, function=found.score),
        sha256=method.sha256,
    )
    PROTOCOLS[method.name] = guarded
    return method.name


def _find_protocol_faults(found: Protocol, name: str) -> Iterator[str]:
    if found.name != name:
        yield f"its Protocol is named {found.name!r}; the two must be the same, rename one"
    for what, names, allowed in (
        ("timings", found.timings, TIMINGS),
        ("sure_end", (found.sure_end,), RATING_RANGE),
    ):
        if not isinstance(names, tuple) or not names or not {*names} <= {*allowed}:
            listed = ", ".join(map(str, allowed))
            yield f"{what} must be of {listed}; got {describe(names)}"
    texts, keys = found.texts, (*WORDS, *PAGE, "anchors")
    if not isinstance(texts, Mapping) or not {*texts} <= {*keys}:
        yield f"texts must be a mapping of {', '.join(keys)}; got {describe(texts)}"
        return
    for key, text in texts.items():
        for one in text if key == "anchors" and isinstance(text, list | tuple) else [text]:
            if not isinstance(one, str) or not one.strip() or "{" in one or "}" in one:
                yield f"texts[{key!r}] must be words without braces, got {describe(one)}"


def _compare(
    items: Items, task: Task, *, method: Method, function: Callable[..., Any], doing: str
) -> Comparisons:
    found = call(method, function, items, task, doing=doing)
    if not isinstance(found, list | tuple):
        raise TypeError(f"{method}: must return Comparisons, got {describe(found)}; {doing}")
    for one in found:
        _check_comparison(method, one, {item.stimulus_id for item in items}, doing=doing)
    return tuple(found)


def _arrange(
    comparison: Comparison, turn: int, *, method: Method, function: Callable[..., Any]
) -> Comparison:
    found: Comparison = call(method, function, comparison, turn, doing="arranging")
    _check_comparison(method, found, _list_ids(comparison), doing="arranging")
    return found


def _score(
    judgement: Judgement,
    answer: float | str,
    parts: Mapping[str, str | None],
    *,
    method: Method,
    function: Callable[..., Any],
) -> float:
    points = call(method, function, judgement, answer, parts, doing="scoring")
    low, high = RATING_RANGE
    if not isinstance(points, float | int) or not low <= points <= high:
        got = f"{describe(points)} for {describe(answer)}"
        raise ValueError(f"{method}: score must return 0 to 100 points, got {got}")
    return float(points)


def _list_ids(one: Comparison) -> set[str | None]:
    judged = {name for j in one.judgements for name in (j.stimulus_id, j.reference_id)}
    return {part.stimulus_id for part in one.parts} | judged


def _check_comparison(method: Method, one: object, known: set[str | None], *, doing: str) -> None:
    is_whole = isinstance(one, Comparison) and (
        all(isinstance(part, Part) for part in one.parts)
        and all(isinstance(judgement, Judgement) for judgement in one.judgements)
    )
    if not isinstance(one, Comparison) or not is_whole:
        must = f"must make Comparisons of Parts and Judgements, got {describe(one)}"
        raise TypeError(f"{method}: {must}; {doing}")
    names = [part.name for part in one.parts]
    listed, strange = ", ".join(names), _list_ids(one) - known - {None, SURFACE}
    other = [judgement.part for judgement in one.judgements if judgement.part not in names]
    faults = {
        "must have parts and judgements": not names or not one.judgements,
        f"names a part twice: {listed}": len({*names}) < len(names),
        f"names stimuli that it was not given: {', '.join(map(str, strange))}": strange,
        f"judges {other[:1] and other[0]!r}, which is not one of its parts: {listed}": other,
        f"must have a catch of {', '.join(map(repr, CATCHES))}, got {one.catch!r}": one.catch
        not in CATCHES,
    }
    for fault in (fault for fault, holds in faults.items() if holds):
        raise ValueError(f"{method}: a comparison {fault}; {doing}")
