"""Verbs of a study: how it is made (new to freeze, demo), and what was found (analyze, audit, seal, export)."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter, Token

from feel321 import intake
from feel321.study.commands import shared
from feel321.study.commands.shared import (
    Crew,
    File,
    Json,
    Name,
    Out,
    Rehearsals,
    Seed,
    Several,
    about,
    verb,
    within,
)
from feel321.study.folder import StudyFolder, list_bundled, read_template
from feel321.study.study import Study

if TYPE_CHECKING:
    from feel321.analysis.report.write import Results
    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.folder import Audit, Seal
    from feel321.study.power import StudyPower


def new(
    folder: Annotated[File | None, Parameter(name="DIR")] = None,
    /,
    *,
    study: Annotated[str | None, about("A ready study.", choices=list_bundled())] = None,
    methods: Annotated[bool, about("Also examples of your own methods, in methods/.")] = False,
    all_settings: Annotated[bool, about("Only print every setting.")] = False,
) -> None:
    """Begin a study: a commented study.toml, ready to use.

    Example: feel321 new my-study
             feel321 new my-study --study park2019
             feel321 new --all-settings
    """
    if all_settings:
        from feel321.study.all_settings import FILES, write_list

        shared.echo("\n".join(map(write_list, FILES)).rstrip("\n"))
    elif folder is None:
        shared.refuse_use("name the folder of the new study")
    elif study and methods:
        shared.refuse_use("--methods adds to a study of your own; leave out --study")
    else:
        made = Study.create(folder, like=study, methods=methods).folder
        shared.echo(f"{made.settings}: edit it, then: feel321 check {quote(str(folder))}")


OWN = "Your own method instead: mylab:my321, methods/my321.py:my321, or its table's name."


def check(
    study: File = Path(),
    /,
    *,
    method: Annotated[Name, about(OWN)] = None,
    kind: Annotated[Literal["reducer", "metric"] | None, about("Guessed if left out.")] = None,
    as_json: Json = False,
) -> int:
    """Check everything that a study needs.

    Settings, recordings, strength of the stimuli, rig and stimulus set: every problem is listed at once. With
    --method: whether a reducer or metric of your own meets feel321's requirements.

    Example: feel321 check my-study
             feel321 check --method mylab.haptics:my321
             feel321 check my-study --method methods/snr.py:snr --kind metric
    """
    if method is not None:
        return _check_method(study, method, kind, as_json=as_json)
    opened = shared.open_study(study, clears=False)
    found = opened.check()
    for text in (*shared.cap(found.remarks), *shared.cap(found.warnings)):
        shared.warn(text)
    count = len(found.warnings) + len(found.remarks)
    counted = f", {count} warning{'s' * (count > 1)}" if count else ""
    good = f"{opened.folder.path}: no problems{counted}"
    lines = [*(shared.cap(found.problems) or [good]), *found.notes]
    warnings = (*found.remarks, *found.warnings)
    facts = {"problems": found.problems, "warnings": warnings, "notes": found.notes}
    shared.print_facts({**facts, **found.figures}, lines, as_json=as_json)
    return 1 if found.problems else 0


def _check_method(folder: Path, name: str, kind: str | None, *, as_json: bool) -> int:
    """Check one of the lab's own methods, and print a line for each check."""
    from feel321.stimuli.conform import check_method
    from feel321.study.settings.read import open_method

    method = open_method(name, folder, kind)
    found = check_method(method)
    failed = sum(not one.passed for one in found)
    outcome = (
        f"{failed} of {len(found)} checks failed" if failed else f"all {len(found)} checks passed"
    )
    lines = [f"{method.kind} {method.name}: {outcome}"]
    lines += [f"  {'ok    ' if one.passed else 'FAILED'}  {one.check}: {one.text}" for one in found]
    facts = {"kind": method.kind, "name": method.name, **method.to_json()}
    shared.print_facts({**facts, "checks": found, "failed": failed}, lines, as_json=as_json)
    return 1 if failed else 0


@verb(Study.build, crew=Crew)
def build(opened: Study, stimuli: "StimulusSet", *, as_json: bool) -> None:
    """Print how many stimuli there are, and what is worth knowing of their gains."""
    from feel321.study.strength import describe_built

    notes = describe_built(opened.settings, stimuli)
    count, folder, sha256 = len(stimuli.stimuli), str(stimuli.folder), stimuli.sha256
    lines = [f"{folder}: {count} stimuli, set {sha256[:12]}", *shared.cap(notes)]
    facts = {"stimuli": count, "folder": folder, "sha256": sha256, "notes": notes}
    shared.print_facts(facts, lines, as_json=as_json)


MOST_OF_ANY = 100_000


def _read_numbers(_kind: type, tokens: Sequence[Token]) -> tuple[int, ...]:
    """Read whole numbers with commas between them, in ascending order, each once."""
    text = tokens[0].value
    try:
        numbers = sorted({int(part) for part in text.split(",")})
    except ValueError:
        numbers = [0]
    if numbers[0] < 1 or numbers[-1] > MOST_OF_ANY:
        allowed = f"whole numbers from 1 to {MOST_OF_ANY} with commas between them, such as 8,12,16"
        raise ValueError(f"must be {allowed}; got {text!r}")
    return tuple(numbers)


Numbers = Annotated[
    tuple[int, ...], Parameter(converter=_read_numbers, n_tokens=1, metavar="N,...")
]


@verb(
    Study.power,
    participants=Numbers,
    recordings=Numbers,
    reducers=Numbers,
    repeats=Numbers,
    effects=Annotated[tuple[str, ...], Parameter(name="--effect", metavar="METRIC=POINTS")],
    pilot=Annotated[str | None, Parameter(metavar="FILE")],
    wanted=Annotated[float, within(0.06, 0.995), Parameter(name="--power")],
    studies=Annotated[int, within(0, 1_000_000)],
    crew=Crew,
    seed=Seed,
    out=Out,
)
def power(_opened: Study, found: "StudyPower", *, as_json: bool) -> None:
    """Print the answer, and where its page is."""
    if not as_json:
        shared.echo(found.summary())
    shared.print_results(found.path, as_json=as_json)


Show = Annotated[bool, about("Only show what is frozen and what changed.")]


def freeze(study: File = Path(), /, *, show: Show = False, as_json: Json = False) -> None:
    """Freeze hypotheses, design and analysis before the first session of a person.

    Writes frozen.json: settings, stimuli, code and hypotheses, with their digests. analyze then marks results as
    confirmatory or exploratory, and names every setting that was changed. It may be written again until a person's
    session has begun. No rating is shown.

    Example: feel321 freeze my-study
             feel321 freeze my-study --show
    """
    from feel321.study import freeze as freezing
    from feel321.study.session.opening import FROZEN_FILE

    opened = shared.open_study(study)
    folder = opened.folder
    if show:
        frozen = freezing.read_frozen(folder)
        changes = freezing.list_changes(folder, opened.settings, frozen) if frozen else {}
    else:
        frozen, changes = freezing.freeze_study(folder, now=opened.now)
    faults = freezing.find_faults(folder)
    for line in () if as_json else faults:
        shared.warn(line)
    lines = [f"{folder.path}: nothing is frozen; before the first session: feel321 freeze"]
    if frozen is not None:
        lines = [f"{folder.path / FROZEN_FILE}: frozen {frozen.utc}, SHA-256 {frozen.sha256}"]
    own = asdict(frozen) if frozen else None
    if own and show:
        lines += shared.lay_facts({name: own[name] for name in ("hypotheses", "settings")})
    if changes:
        lines += ["changed:", *(f"  {one}" for one in changes.values())]
    facts = {"frozen": own, "changes": [*changes.values()], "faults": faults}
    shared.print_facts(facts, lines, as_json=as_json)


DEMO_PARTICIPANTS = 16


Home = Annotated[File, about("Folder of the study.", name=["--out", "-o"])]


def demo(*, out: Home = Path("demo-study")) -> None:
    """Run a whole study with simulated participants.

    Example: feel321 demo --out demo-study
    """
    from feel321.study.observer.model import NUMBERED

    folder = StudyFolder(out)
    if not folder.path.exists() or not any(folder.path.iterdir()):
        Study.create(folder.path)
    # What is anything but the demonstration is left alone.
    people = [entry.name for entry in folder.participants if not NUMBERED.fullmatch(entry.name)]
    refusal = ""
    if not folder.settings.is_file():
        refusal = f"{folder.path}: holds files that demo did not write"
    elif intake.read_small(folder.settings) != read_template():
        refusal = f"{folder.settings}: edited, or written by another version of feel321"
    elif people:
        refusal = f"{folder.path}: holds a session of {people[0]}, who is no simulated participant"
    if refusal:
        raise FileExistsError(f"{refusal}; name another folder with --out")
    opened = shared.open_study(folder.path)
    stimuli = opened.build()
    shared.echo(f"{stimuli.folder}: {len(stimuli.stimuli)} stimuli")
    rows = shared.simulate_sessions(opened, DEMO_PARTICIPANTS)
    said = f"{rows} ratings of {DEMO_PARTICIPANTS} simulated participants"
    shared.echo(f"{opened.folder.ratings}: {said}")
    opened.analyze()
    shared.print_results(opened.folder.report, as_json=False)


@verb(
    Study.analyze,
    needs_study=False,
    ratings=File | None,
    manifest=File | None,
    out=Out,
    metrics=Several,
)
def analyze(_opened: Study, found: "Results", *, as_json: bool) -> None:
    """Print where the report is."""
    shared.print_results(found.path, as_json=as_json)


PER_FILE = 10  # findings of one file that are printed; the others are counted


@verb(
    Study.audit,
    clears=False,
    remotes=Annotated[tuple[str, ...], Parameter(name="--remote", metavar="REMOTE")],
    expect=Annotated[str, Parameter(metavar="ID")],
    rehearsals=Rehearsals,
)
def audit(opened: Study, found: "Audit", *, as_json: bool) -> int:
    """Print the findings, file by file."""
    by_file: dict[str, list[str]] = defaultdict(list)
    for text in found.findings:
        by_file[text.partition(": ")[0].partition(", line ")[0]].append(text)
    lines = []
    for own in by_file.values():
        more = f"  and {len(own) - PER_FILE} more in this file (--json lists all)"
        lines += [*own[:PER_FILE], *([more] if len(own) > PER_FILE else [])]
    n = len(opened.folder.journals)
    good = f"{opened.folder.path}: {n} journal{'s' * (n != 1)}, no contradiction in them"
    lines = [*(shared.cap(lines) or [good]), *filter(None, [found.sentence]), *found.remarks]
    shared.print_facts(asdict(found), lines, as_json=as_json)
    return 1 if found.findings else 0


@verb(Study.seal, reason=str, to=Annotated[str, Parameter(metavar="REMOTE")])
def seal(opened: Study, found: "Seal", *, as_json: bool) -> None:
    """Print the checkpoint, and where it was pushed to."""
    for problem in found.problems:
        shared.warn(problem)
    unset = "not pushed, because no remote is set: feel321 seal --to REMOTE"
    places = [f"pushed to {place}" for place in found.places] or [unset]
    lines = [f"{opened.folder.path}: checkpoint {found.checkpoint}", *places]
    shared.print_facts(asdict(found), lines, as_json=as_json)


def export(
    *study_dir: Annotated[File, Parameter(name="[STUDY] DIR")],
    simulated: Annotated[bool, about("Simulated participants too, marked as such.")] = False,
    for_r: Annotated[bool, about("Write for R and JASP instead.", name="--r")] = False,
    as_json: Json = False,
) -> None:
    """Write a study's data for others, into the folder DIR.

    Writes a BIDS dataset for a repository: participants get random numbers; answers to question pages, notes, days and
    names of machines are left out. --r writes CSV files for R, JASP and jamovi, with the study's codes of participants,
    and model.R, which fits the primary models with lme4.

    Example: feel321 export my-study dataset
             feel321 export my-study for-r --r
    """
    from feel321.study.persons.withdrawal import recording_output

    folder, target = shared.split_study(study_dir, "a folder to write")
    if for_r and simulated:
        shared.refuse_use("--simulated is for BIDS; leave it out with --r")
    if len(study_dir) == 1 and (target / "study.toml").is_file():
        need = f"name the folder to write, too: feel321 export {target} DIR"
        shared.refuse_use(f"{target} is a study; {need}")
    opened = Study.open(folder)
    notices: list[str] = []
    with recording_output(opened.folder, "export", target, now=opened.now):
        if for_r:
            from feel321.analysis.export import export_r

            table, step = opened.table(), "next, in that folder: Rscript model.R"
            if "simulated" in table.rows and table.rows["simulated"].any():
                said = "ratings of simulated participants are among these"
                notices.append(f"{said}; see the column simulated")
            export_r(table, target, rng=opened.settings.study.seed)
        else:
            from feel321.study.export.dataset import export_bids

            step = f"check it with: bids-validator-deno {target}"
            notices += export_bids(opened.folder, target, simulated=simulated)
    for line in notices:
        shared.warn(line)
    facts = {"folder": str(target), "kind": "R" if for_r else "BIDS", "warnings": notices}
    shared.print_facts(facts, [f"{target}: {step}"], as_json=as_json)
