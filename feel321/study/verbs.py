"""The verbs of the command line, each made of a method of `Study`, or of a function where there need be no study.

Options come from the signature, read as `feel321.study.options` says, help from the docstring. What is returned is
printed: lines for people, or with --json the numbers.
"""

import inspect
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, get_args, get_type_hints

from cyclopts import Parameter

from feel321 import files
from feel321.study import options, signals
from feel321.study.folder import SETTINGS_FILE, Outcome, StudyFolder, UsageError, require_study
from feel321.study.study import Study
from feel321.study.terminal import cap, dump_json, echo, wants_bar, warn

GROUPS = {
    "Design": ("new", "check", "build", "power", "freeze", "tradeoff"),
    "Lab": ("calibrate", "doctor", "run", "simulate", "status", "note", "collect", "withdraw"),
    "Results": ("analyze", "audit", "seal", "export"),
    "Signals": ("reduce", "match"),
    "Example": ("demo",),
}
"""Group of the help -> its verbs."""

ANYWHERE = {"analyze", "check", "doctor"}
"""Verbs that can do something without a study."""

READING = {*ANYWHERE, "audit", "calibrate", "export", "status"}
"""Verbs that leave what a killed process left."""

WORDY = {"run"}
"""Verbs that print as they go, and no numbers at their end."""

PER_FILE = 10  # findings of one file that are printed; the others are counted

NAMED = partial(inspect.Parameter, kind=inspect.Parameter.KEYWORD_ONLY)
Json = Annotated[bool, Parameter(name="--json", help="Print numbers as JSON.")]
Into = Annotated[
    options.File, Parameter(help="Study to collect into. [default: .]", metavar="STUDY")
]


def open_study(name: str, path: Path) -> Study:
    """Open the study that a verb works on; what killed processes left in it goes, unless the verb only reads."""
    if name not in ANYWHERE:
        require_study(path)
    if name not in READING and (swept := [*files.sweep(path), *files.sweep_temporary()]):
        names, more = ", ".join(map(str, swept[:5])), len(swept) - 5
        warn(f"removed what an interrupted run left: {names}{f' and {more} more' * (more > 0)}")
    return Study(StudyFolder(path), wants_bar(), warn=warn)


def make_verb(name: str) -> Callable[..., int]:
    """Make a verb of what has its name: a function whose arguments are those of a command line, and its exit code."""
    do: Callable[..., Any] = getattr(Study, name, None) or getattr(signals, name)
    parameters = _list_parameters(do)
    if name not in WORDY and inspect.signature(do).return_annotation != "None":
        parameters.append(NAMED("as_json", default=False, annotation=Json))

    def call(*words: Any, as_json: bool = False, **given: Any) -> int:  # noqa: ANN401
        if not hasattr(Study, name):
            return finish(do(*words, **given), as_json=as_json)
        path, rest = _split(name, parameters[0], words, into=given.pop("into", None))
        study = open_study(name, path)
        found = getattr(study, name)(*rest, **given)
        return finish(SHOWN[name](study, found) if name in SHOWN else found, as_json=as_json)

    call.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    call.__annotations__ = {one.name: one.annotation for one in parameters}
    call.__doc__ = do.__doc__
    return call


def _list_parameters(do: Callable[..., Any]) -> list[inspect.Parameter]:
    """List the parameters of a verb: those of a function, or of a method, with the study in the place of `self`."""
    own = dict(inspect.signature(do).parameters)
    is_method = own.pop("self", None) is not None
    texts = SimpleNamespace(__annotations__={one.name: one.annotation for one in own.values()})
    hints = get_type_hints(texts, {"options": options}, include_extras=True)
    listed = [one.replace(annotation=hints[one.name]) for one in own.values()]
    if not is_method:
        return listed
    places = [one for one in listed if one.kind is one.VAR_POSITIONAL or one.default is one.empty]
    places = [one for one in places if one.kind is not one.KEYWORD_ONLY]
    named = [NAMED(one.name, default=one.default, annotation=one.annotation)
             for one in listed if one not in places]  # fmt: skip
    if not places:
        only = inspect.Parameter.POSITIONAL_ONLY
        study = inspect.Parameter("study", only, default=Path(), annotation=options.File)
        return [study, *named]
    if places[0].kind is inspect.Parameter.VAR_POSITIONAL:
        return [*places, *named, NAMED("into", default=Path(), annotation=Into)]
    words = f"[STUDY] {get_args(places[0].annotation)[1].metavar}"
    annotation = Annotated[str, Parameter(name=words, required=True)]
    several = inspect.Parameter.VAR_POSITIONAL
    return [inspect.Parameter("words", several, annotation=annotation), *named]


def _split(
    name: str, first: inspect.Parameter, words: Sequence[Any], *, into: Path | None
) -> tuple[Path, Sequence[Any]]:
    """Split the study from the arguments of a method."""
    if first.kind is first.POSITIONAL_ONLY:
        return (words[0] if words else Path()), ()
    if first.name != "words":
        return into or Path(), words
    what, (*before, last) = get_args(first.annotation)[1].name[0].split()[-1], words
    if len(before) > 1:
        raise UsageError(f"takes a study and {what}, got {len(words)} words")
    if not before and (Path(last) / SETTINGS_FILE).is_file():
        raise UsageError(f"{last} is a study; name {what}, too: feel321 {name} {last} {what}")
    return Path(*before), (last,)


def finish(outcome: Outcome | None, *, as_json: bool) -> int:
    """Print what a verb returned; faults are errors."""
    if outcome is None:
        return 0
    if as_json and isinstance(outcome.facts, Path):
        echo(outcome.facts.read_text(encoding="utf-8"))
    elif as_json:
        echo(dump_json(outcome.facts))
    elif outcome.lines:
        echo("\n".join(outcome.lines))
    if outcome.faults:
        raise OSError("\n".join(outcome.faults))
    return int(outcome.failed)


# What is printed of results that are more than an outcome.


def show_problems(study: Study, found: Any) -> Outcome:  # noqa: ANN401 - see `SHOWN`
    """Show what stands in the way of a study; warnings go to stderr."""
    for text in (*cap(found.remarks), *cap(found.warnings)):
        warn(text)
    count = len(found.warnings) + len(found.remarks)
    counted = f", {count} warning{'s' * (count > 1)}" if count else ""
    good = f"{found.subject or study.folder.path}: no problems{counted}"
    warnings = (*found.remarks, *found.warnings)
    facts = {"problems": found.problems, "warnings": warnings, "notes": found.notes}
    lines = [*(cap(found.problems) or [good]), *found.notes]
    return Outcome(facts | found.figures, lines, failed=bool(found.problems))


def show_set(study: Study, found: Any) -> Outcome:  # noqa: ANN401
    """Show how many stimuli there are, and what is worth knowing of their gains."""
    from feel321.study.strength import describe_built

    notes = describe_built(study.settings, found)
    count, folder = len(found.stimuli), str(found.folder)
    facts = {"stimuli": count, "folder": folder, "sha256": found.sha256, "notes": notes}
    return Outcome(facts, [f"{folder}: {count} stimuli, set {found.sha256[:12]}", *cap(notes)])


def show_simulated(study: Study, found: Any) -> Outcome:  # noqa: ANN401
    """Show how many ratings there are, and what was planted in them."""
    from feel321.study.simulation import regress_planted

    slopes, reducers = regress_planted(study.settings, study.stimuli())
    file, people = str(study.folder.ratings), found["participant"].nunique()
    facts = {"participants": people, "ratings": len(found), "file": file, "planted": slopes}
    facts |= {"planted_reducers": reducers} if reducers else {}
    terms = [f"{slope:.2f} per +0.1 of {metric}" for metric, slope in slopes.items()]
    terms += [f"{points:+.1f} for {reducer}" for reducer, points in reducers.items()]
    said = f" in realism, in points: {', '.join(terms)}" if terms else ": more than the two matches"
    return Outcome(facts, [f"{file}: {len(found)} ratings", f"planted{said}"])


def show_status(_study: Study, found: Any) -> Outcome:  # noqa: ANN401
    """Show the table of participants."""
    return Outcome(asdict(found), [found.summary()])


def show_session(_study: Study, found: Any) -> Outcome:  # noqa: ANN401
    """Show nothing: the session has said how far it is."""
    return Outcome({}, failed=bool(found.stopped))


def show_page(_study: Study, found: Any) -> Outcome:  # noqa: ANN401
    """Show where the page is, below the answer if there is one."""
    answer = [found.summary()] if hasattr(found, "answer") else []
    return Outcome(found.path / "results.json", [*answer, str(found.path / "index.html")])


def show_audit(study: Study, found: Any) -> Outcome:  # noqa: ANN401
    """Show the findings, file by file."""
    by_file: dict[str, list[str]] = defaultdict(list)
    for text in found.findings:
        by_file[text.partition(": ")[0].partition(", line ")[0]].append(text)
    lines = []
    for own in by_file.values():
        more = f"  and {len(own) - PER_FILE} more in this file (--json lists all)"
        lines += [*own[:PER_FILE], *([more] if len(own) > PER_FILE else [])]
    n = len(study.folder.journals)
    good = f"{study.folder.path}: {n} journal{'s' * (n != 1)}, no contradiction in them"
    lines = [*(cap(lines) or [good]), *filter(None, [found.sentence]), *found.remarks]
    return Outcome(asdict(found), lines, failed=bool(found.findings))


def show_seal(study: Study, found: Any) -> Outcome:  # noqa: ANN401
    """Show the checkpoint, and where it was pushed to."""
    for problem in found.problems:
        warn(problem)
    unset = "not pushed, because no remote is set: feel321 seal --to REMOTE"
    places = [f"pushed to {place}" for place in found.places] or [unset]
    return Outcome(asdict(found), [f"{study.folder.path}: checkpoint {found.checkpoint}", *places])


SHOWN: dict[str, Callable[[Study, Any], Outcome]] = {
    "analyze": show_page, "audit": show_audit, "build": show_set, "check": show_problems, "power": show_page,
    "run": show_session, "seal": show_seal, "simulate": show_simulated, "status": show_status,
}  # fmt: skip
"""Verb -> what shows the result of its method."""
