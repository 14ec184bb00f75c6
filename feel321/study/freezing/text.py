"""What is frozen, for reading: its state, and the text of a pre-registration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from feel321.analysis.words import format_name, join_words
from feel321.study.freezing.choices import describe_value
from feel321.study.freezing.record import describe_rated

if TYPE_CHECKING:
    from collections.abc import Iterator

    from feel321.study.freezing.freeze import FreezeState
    from feel321.study.freezing.record import Frozen


def describe_written(frozen: Frozen) -> str:
    """Say what was frozen, in a line."""
    n = f", {frozen.participants} participants planned" if frozen.participants else ""
    late = (
        f"; {describe_rated(frozen.rated)} came before, so every result is exploratory"
        if frozen.is_late
        else ""
    )
    count = len(frozen.hypotheses)
    what = f"{count} {'hypothesis' if count == 1 else 'hypotheses'}, {len(frozen.choices)} choices"
    return f"{what}{n}, frozen {frozen.utc}, digest {frozen.sha256[:12]}{late}"


def describe_json(state: FreezeState) -> dict[str, Any]:
    """Return the state as what JSON can hold."""
    frozen = state.frozen
    own = None if frozen is None else frozen.to_json() | {"sha256": frozen.sha256}
    return {"frozen": own, "changes": list(state.changes), "faults": list(state.faults)}


def write_state(state: FreezeState) -> str:
    """Write what is frozen, with its history, and what differs now."""
    frozen = state.frozen
    if frozen is None and state.faults:
        return "\n".join([f"{state.name}: what was frozen is missing", *state.faults])
    if frozen is None:
        return f"{state.name}: nothing is frozen; freeze it before the first rating: feel321 freeze"
    lines = [f"{state.name}: {describe_written(frozen)}"]
    lines += [f"  earlier: {one.utc}" for one in frozen.history]
    lines += [f"  because: {frozen.because}"] if frozen.because else []
    lines += ["hypotheses:", *(f"  {one}" for one in frozen.words), "choices:"]
    lines += [f"  {name} = {describe_value(value)}" for name, value in frozen.choices.items()]
    changed = [f"  {one}" for one in (*state.faults, *state.changes)]
    return "\n".join([
        *lines,
        *(["changed since:", *changed] if changed else ["changed since: nothing"]),
    ])


# The text of a pre-registration.


def write_registration(state: FreezeState) -> str:
    """Write the text of a pre-registration, from the frozen state, or from today's settings where there is none."""
    one = state.frozen or state.now
    blocks = {
        "Hypotheses": _write_hypotheses(one),
        "Design": _write_design(one),
        "Participants": _write_participants(one),
        "Exclusions": _write_exclusions(one),
        "Analysis": _write_analysis(one),
        "What would count as support, and what against": _write_criteria(one),
        "Materials and software": _write_materials(one),
    }
    head = [f"# Pre-registration: {state.name}"]
    if state.frozen is None:
        head.append("Draft from today's settings: nothing is frozen yet.")
    elif state.frozen.is_late:
        head.append(
            f"Written after {describe_rated(state.frozen.rated)}: not a pre-registration, all exploratory."
        )
    parts = [f"## {title}\n\n" + "\n".join(lines) for title, lines in blocks.items()]
    return "\n\n".join([*head, *parts])


def _write_hypotheses(one: Frozen) -> Iterator[str]:
    for number, text in enumerate(one.words, start=1):
        yield f"{number}. {text}"
    yield ""
    yield "Ratings run from 0 to 100. Everything else that the report shows is exploratory."


def _list(one: Frozen, name: str) -> str:
    value = one.choices.get(name)
    return join_words([format_name(str(entry)) for entry in value]) if value else "none"


def _write_design(one: Frozen) -> Iterator[str]:
    get = one.choices.get
    recordings = [name.partition(".")[2] for name in one.choices if name.startswith("recordings.")]
    share = get("session.recordings_per_participant")
    yield f"- Recordings ({len(recordings)}): {join_words(recordings)}."
    yield f"- Reducers ({len(get('stimuli.reducers', ()))}): {_list(one, 'stimuli.reducers')}."
    yield (
        f"- Levels: {_list(one, 'stimuli.levels')}; anchors: {'yes' if get('stimuli.anchors') else 'no'}; "
        f"reference: {get('stimuli.reference')}."
    )
    yield (
        f"- Tasks: {_list(one, 'session.protocols')}; every stimulus is rated {_count_times(get('session.repeats'))} "
        f"by {'everyone' if share is None else f'those who feel its recording ({share} recordings each)'}."
    )
    orders = f"order of tasks: {get('session.task_order')}; seed {get('study.seed')}"
    yield f"- Order of trials: {get('session.order')}; {orders}."
    factors = [name.partition(".")[2] for name in one.choices if name.startswith("between.")]
    if factors:
        yield f"- Between participants: {join_words(factors)}."


def _count_times(count: object) -> str:
    return "once" if count == 1 else f"{count} times"


def _write_participants(one: Frozen) -> Iterator[str]:
    if one.participants is None:
        yield "The number of participants is not fixed in advance."
        return
    by = (
        " (from a simulation of this study with feel321 power)"
        if one.planned_by == "feel321 power"
        else ""
    )
    yield f"{one.participants} participants{by}. The analysis is run when their sessions are complete."


def _write_exclusions(one: Frozen) -> Iterator[str]:
    get = one.choices.get
    flags = join_words(
        [format_name(flag) for flag in get("session.quality.reject", ())] or ["no flag"], "or"
    )
    yield (
        f"- Trials: a rating is rejected, and the trial repeated up to {get('session.quality.max_attempts')} times, "
        f"for: {flags}; or if it came faster than {get('session.quality.min_response_s')} s."
    )
    yield f"- In the analysis: {get('analysis.exclusions')}."
    yield f"- Further screening rules: {_list(one, 'analysis.screening')}."


def _write_analysis(one: Frozen) -> Iterator[str]:
    get, margin = one.choices.get, one.choices.get("analysis.margin")
    yield f"- Model, for each scale and level: {get('analysis.model')}."
    yield f'- Metrics: {_list(one, "analysis.metrics")}; "within": less the mean over the stimuli of the recording.'
    level = f"{get('analysis.alpha')}; {get('analysis.correction')}"
    yield f"- Test: two-sided t test of each slope within recordings at {level}."
    yield f"- Not estimable: {get('analysis.not_estimable')}."
    points = "none declared; equivalence is not tested" if margin is None else f"{margin:g} points"
    yield f"- Margin of equivalence between reducers: {points}."
    yield f"- Bootstrap draws: {get('analysis.draws')}; random seed: {get('study.seed')}."


def _write_criteria(one: Frozen) -> Iterator[str]:
    alpha = one.choices.get("analysis.alpha")
    yield f"- Support: the adjusted p of the slope is below {alpha} and its sign is that of the hypothesis."
    yield f"- Against: the adjusted p is below {alpha} and the sign is the opposite one."
    yield "- Otherwise the question stays open; a non-significant slope is not evidence of no effect."
    yield "- If leaving out a single recording, reducer or stimulus changes the verdict or the sign, it is reported."


def _write_materials(one: Frozen) -> Iterator[str]:
    yield f"- Stimulus set: SHA-256 {one.choices.get('stimuli.set')}."
    for name, sha256 in one.choices.items():
        if name.startswith("code."):
            yield f"- Own {name.split('.')[1].replace('_', ' ')} {name.split('.', 2)[2]}: SHA-256 {sha256}."
    yield f"- Software: {join_words([f'{name} {number}' for name, number in one.versions.items()])}."
    if one.sha256:
        yield f"- Frozen {one.utc}; SHA-256 of the frozen state: {one.sha256}."
