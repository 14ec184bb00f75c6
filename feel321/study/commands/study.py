"""Verbs of a study: how it is made (new to freeze, demo), and what was found (analyze, audit, seal, export)."""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from shlex import quote
from typing import Annotated, Literal

from cyclopts import Parameter, Token

from feel321 import intake
from feel321.study.commands import shared
from feel321.study.commands.shared import (
    ALONE,
    Crew,
    File,
    Json,
    Out,
    Rehearsals,
    Seed,
    Several,
    within,
)
from feel321.study.folder import StudyFolder, list_bundled, read_template, require_study
from feel321.study.session.opening import FROZEN_FILE
from feel321.study.study import Study


def new(
    folder: Annotated[File | None, Parameter(name="DIR")] = None,
    /,
    *,
    study: Annotated[str | None, Parameter(choices=list_bundled())] = None,
    methods: bool = False,
    texts: Annotated[str | None, Parameter(metavar="LANGUAGE")] = None,
    all_settings: bool = False,
) -> None:
    """Begin a study: a commented study.toml, ready to use.

    Example: feel321 new my-study
             feel321 new my-study --study park2019
             feel321 new my-study --texts de
             feel321 new --all-settings

    Parameters
    ----------
    study
        A ready study.
    methods
        Also examples of your own methods, in methods/.
    texts
        Only write the participants' texts (en, de).
    all_settings
        Only print every setting.
    """
    if all_settings:
        from feel321.study.all_settings import FILES, write_list

        shared.echo("\n".join(write_list(file) for file in FILES).rstrip("\n"))
        return
    if texts is not None:
        from feel321.doors import check_name
        from feel321.files import create_text
        from feel321.protocols.texts import COPY_FILE, list_languages, write_copy

        check_name(texts, list_languages(), "--texts")
        path = require_study(folder or Path()).path / COPY_FILE
        create_text(path, write_copy(texts))
        use = f'in study.toml under [session]: language = "{COPY_FILE}"'
        shared.echo(f"{path}: edit it, then {use}")
        return
    if folder is None:
        shared.refuse_use("name the folder of the new study")
    if study and methods:
        shared.refuse_use("--methods adds to a study of your own; leave out --study")
    made = Study.create(folder, like=study, methods=methods).folder
    shared.echo(f"{made.settings}: edit it, then: feel321 check {quote(str(folder))}")


def check(
    study: File = Path(),
    /,
    *,
    method: Annotated[str | None, Parameter(metavar="NAME")] = None,
    kind: Literal["reducer", "metric"] | None = None,
    as_json: Json = False,
) -> int:
    """Check everything that a study needs.

    Settings, recordings, strength of the stimuli, rig and stimulus set: every problem is listed at once. With
    --method: whether a reducer or metric of your own meets feel321's requirements.

    Example: feel321 check my-study
             feel321 check --method mylab.haptics:my321
             feel321 check my-study --method methods/psnr.py:psnr --kind metric

    Parameters
    ----------
    method
        A method of your own instead: mylab:my321, methods/my321.py:my321, or its table's name.
    kind
        Kind of method; guessed if left out.
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
    facts = {"problems": found.problems, "warnings": found.warnings, "notes": found.notes}
    shared.print_facts({**facts, **found.figures}, lines, as_json=as_json)
    return 1 if found.problems else 0


def _check_method(folder: Path, name: str, kind: str | None, *, as_json: bool) -> int:
    """Check one of the lab's own methods, and print a line for each check."""
    from feel321.stimuli.conform import check_method
    from feel321.study.methods import open_method

    method = open_method(name, folder, kind)
    found = check_method(method)
    failed = sum(not one.passed for one in found)
    passed = f"all {len(found)} checks passed"
    outcome = f"{failed} of {len(found)} checks failed" if failed else passed
    lines = [f"{method.kind} {method.name}: {outcome}"]
    marks = {True: "ok    ", False: "FAILED"}
    lines += [f"  {marks[one.passed]}  {one.check}: {one.text}" for one in found]
    facts = {"kind": method.kind, "name": method.name, **method.to_json()}
    shared.print_facts({**facts, "checks": found, "failed": failed}, lines, as_json=as_json)
    return 1 if failed else 0


def build(
    study: File = Path(), /, *, crew: Crew = ALONE, no_page: bool = False, as_json: Json = False
) -> None:
    """Build the stimulus set; only what changed is made again.

    Open stimuli/index.html in a browser to see, measure and hear every stimulus.

    Example: feel321 build my-study --workers 2

    Parameters
    ----------
    no_page
        No stimuli/index.html.
    """
    from feel321.study.strength import describe_built

    workers, opened = crew.employ(), shared.open_study(study)
    stimuli = opened.build(workers, page=not no_page)
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


def _read_effects(texts: Sequence[str]) -> dict[str, float]:
    effects: dict[str, float] = {}
    for text in texts:
        name, _, points = text.rpartition("=")
        try:
            value = float(points)
        except ValueError:
            value = math.nan
        if not name or not abs(value) <= shared.MOST:
            shared.refuse_use(
                f"--effect must be METRIC=POINTS, such as temporal_match=1.5; got {text!r}"
            )
        if name in effects:
            shared.refuse_use(f"--effect: got {name!r} twice; give it once")
        effects[name] = value
    return effects


def power(  # noqa: PLR0913 - one per option
    study: File = Path(),
    /,
    *,
    participants: Numbers = (),
    recordings: Numbers = (),
    reducers: Numbers = (),
    repeats: Numbers = (),
    effect: Annotated[tuple[str, ...], Parameter(metavar="METRIC=POINTS")] = (),
    hypothesis: Annotated[str | None, Parameter(metavar="ATTRIBUTE/METRIC")] = None,
    pilot: Annotated[str | None, Parameter(metavar="FILE")] = None,
    manifest: File | None = None,
    wanted: Annotated[float, within(0.06, 0.995), Parameter(name="--power")] = 0.8,
    studies: Annotated[int, within(0, 1_000_000)] = 1000,
    crew: Crew = ALONE,
    seed: Seed = None,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Find how many participants, recordings and reducers a study needs.

    Simulates this very study: its stimuli, protocols, primary model and Holm's method. Writes a page, tables
    and JSON into STUDY/power. After Ctrl-C the same command continues.

    Example: feel321 power my-study --participants 8,12,16,24 --effect spectral_match_bounded=2 --workers 2

    Parameters
    ----------
    participants
        Numbers of participants.  [default: 8 to 48]
    recordings
        Numbers of recordings.  [default: half to three times the study's]
    reducers
        Numbers of reducers.  [default: half to 1.5 times the study's]
    repeats
        Ratings of each stimulus by one person.  [default: 1 to 4]
    effect
        Slope to plan for, in points per +0.1 of a match, or per power of ten (+1 dB) of other metrics; repeatable;
        ATTRIBUTE/METRIC for one scale.  [default: as simulated observers feel]
    hypothesis
        The slope to recommend a design for.  [default: the one with least power]
    pilot
        Ratings to take standard deviations from; 'study': its own.  [default: published ones]
    manifest
        The stimuli of the pilot.  [default: the study's]
    wanted
        Target power.
    studies
        Simulated studies of each checked design; 0: closed form only.
    """
    workers, effects, opened = crew.employ(), _read_effects(effect), shared.open_study(study)
    target = out or opened.folder.path / "power"
    sizes = {
        "participants": participants, "recordings": recordings, "reducers": reducers, "repeats": repeats,
    }  # fmt: skip
    with shared.recording(opened.folder, "power", target):
        found = opened.power(
            **sizes,
            effects=effects,
            hypothesis=hypothesis,
            pilot=pilot,
            manifest=manifest,
            wanted=wanted,
            studies=studies,
            workers=workers,
            seed=seed,
            folder=target,
        )
    if not as_json:
        shared.echo(found.summary())
    shared.print_results(target, as_json=as_json)


def freeze(study: File = Path(), /, *, show: bool = False, as_json: Json = False) -> None:
    """Freeze hypotheses, design and analysis before the first rating is seen.

    Writes frozen.json: settings, stimuli, code and hypotheses, with their digests. analyze then marks results as
    confirmatory or exploratory, and names every setting that was changed. It may be written again until a person's
    session has begun. No rating is shown.

    Example: feel321 freeze my-study
             feel321 freeze my-study --show

    Parameters
    ----------
    show
        Only show what is frozen and what changed.
    """
    from feel321.study import freeze as freezing

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


def demo(*, out: Out = Path("demo-study")) -> None:
    """Run a whole study with simulated participants.

    Example: feel321 demo --out demo-study
    """
    folder = out or Path()
    if not folder.exists() or not any(folder.iterdir()):
        Study.create(folder)
    _require_demo(StudyFolder(folder))
    opened = shared.open_study(folder)
    stimuli = opened.build()
    shared.echo(f"{stimuli.folder}: {len(stimuli.stimuli)} stimuli")
    rows = opened.simulate_sessions(DEMO_PARTICIPANTS)
    table = opened.folder.ratings
    shared.echo(f"{table}: {rows} ratings of {DEMO_PARTICIPANTS} simulated participants")
    opened.analyze()
    shared.print_results(opened.folder.report, as_json=False)


def _require_demo(study: StudyFolder) -> None:
    """Refuse a folder that holds anything but the demonstration, which is then left alone."""
    from feel321.study.observer.model import NUMBERED

    people = [entry.name for entry in study.participants if not NUMBERED.fullmatch(entry.name)]
    refusal = ""
    if not study.settings.is_file():
        refusal = f"{study.path}: holds files that demo did not write"
    elif intake.read_small(study.settings) != read_template():
        refusal = f"{study.settings}: edited, or written by another version of feel321"
    elif people:
        refusal = f"{study.path}: holds a session of {people[0]}, who is no simulated participant"
    if refusal:
        raise FileExistsError(f"{refusal}; name another folder with --out")


def analyze(  # noqa: PLR0913 - one per option
    study: File = Path(),
    /,
    *,
    ratings: File | None = None,
    manifest: File | None = None,
    out: Out = None,
    metric: Several = (),
    rivals: bool = False,
    as_json: Json = False,
) -> None:
    """Relate the ratings to the match metrics and write the report.

    Writes index.html, results.json (every number of the page; --json prints it), tables/ and figures/ into
    STUDY/report. Metrics, bootstrap draws and margin of equivalence are declared in study.toml, [analysis].

    Example: feel321 analyze my-study
             feel321 analyze --ratings ratings.csv --manifest manifest.csv --out report
             feel321 analyze --ratings ratings.csv --manifest manifest.csv --metric roughness_match
             feel321 analyze my-study --rivals

    Parameters
    ----------
    ratings
        Ratings from elsewhere; needs --manifest outside a study.
    manifest
        The stimuli rated.  [default: the study's]
    metric
        A numeric manifest column to analyze; repeatable.  [default: as declared]
    rivals
        Also rank all metrics, corrected for how many were tried.
    """
    folder = StudyFolder(study)
    if manifest is not None and ratings is None:
        shared.refuse_use("--manifest needs --ratings; give both, or --ratings alone in a study")
    if ratings is not None and manifest is None and not folder.settings.is_file():
        shared.refuse_use(
            "--ratings needs the table of the stimuli that were rated: add --manifest FILE, or name the study first"
        )
    target, opened = out or folder.report, Study(folder, shared.wants_bar(), warn=shared.warn)
    with shared.recording(folder, "analyze", target):
        opened.analyze(rivals=rivals, metrics=metric, ratings=ratings, manifest=manifest, out=out)
    shared.print_results(target, as_json=as_json)


PER_FILE = 10
"""Findings of one file that are printed; the others are counted."""


def audit(
    study: File = Path(),
    /,
    *,
    remote: Annotated[tuple[str, ...], Parameter(metavar="REMOTE")] = (),
    expect: Annotated[str, Parameter(metavar="ID")] = "",
    rehearsals: Rehearsals = False,
    as_json: Json = False,
) -> int:
    """Verify plans, journals and stimuli; list every change.

    Compares the journals with plans, tables and report, and the files with the checkpoints in .evidence and at
    its remotes. What no checkpoint covers is not judged: recordings, personal answers, other results.

    Example: feel321 audit my-study
             feel321 audit my-study --remote /media/usb/evidence.git
             feel321 audit my-study --expect 5f0c2a7e91d4

    Parameters
    ----------
    remote
        A further git remote with checkpoints; repeatable.
    expect
        Fail without this checkpoint.
    """
    opened = shared.open_study(study, rehearsals=rehearsals, clears=False)
    found = opened.audit(expect=expect, remotes=remote)
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


def seal(
    study: File = Path(),
    /,
    *,
    reason: str = "",
    to: Annotated[str, Parameter(metavar="REMOTE")] = "",
    as_json: Json = False,
) -> None:
    """Take a checkpoint of the study, and push it to its remotes.

    A checkpoint is a commit in the git repository .evidence of the study: digests of its files, never their contents.
    A remote that others cannot write to reveals every later change (feel321 audit); it may be a folder that is not
    there yet, and is kept if it takes this checkpoint.

    Example: feel321 seal my-study
             feel321 seal my-study --to /mnt/elsewhere/my-study.git
             feel321 seal my-study --reason "analysis.draws raised, as preregistered"

    Parameters
    ----------
    reason
        Why settings, texts or methods changed.
    to
        Git remote to push to from now on: a folder outside the study, or a URL.
    """
    opened = shared.open_study(study)
    found = opened.seal(reason, to=to)
    for problem in found.problems:
        shared.warn(problem)
    unset = "not pushed, because no remote is set: feel321 seal --to REMOTE"
    places = [f"pushed to {place}" for place in found.places] or [unset]
    lines = [f"{opened.folder.path}: checkpoint {found.checkpoint}", *places]
    shared.print_facts(asdict(found), lines, as_json=as_json)


def export(
    *study_dir: Annotated[File, Parameter(name="[STUDY] DIR")],
    keep_ids: bool = False,
    simulated: bool = False,
    for_r: Annotated[bool, Parameter(name="--r")] = False,
) -> None:
    """Write a study's data for others, into the folder DIR.

    Writes a BIDS dataset for a repository: participants get random numbers; personal answers, typed texts, notes, days
    and names of machines are left out. --r writes CSV files for R, JASP and jamovi, with the study's codes of
    participants, and model.R, which fits the primary models with lme4.

    Example: feel321 export my-study dataset
             feel321 export my-study for-r --r

    Parameters
    ----------
    keep_ids
        Keep participants' codes.
    simulated
        Simulated participants too, marked as such.
    for_r
        Write for R and JASP instead.
    """
    folder, target = shared.split_study(study_dir, "a folder to write")
    if for_r and (keep_ids or simulated):
        shared.refuse_use("--keep-ids and --simulated are for BIDS; leave them out with --r")
    if len(study_dir) == 1 and (target / "study.toml").is_file():
        need = f"name the folder to write, too: feel321 export {target} DIR"
        shared.refuse_use(f"{target} is a study; {need}")
    study = require_study(folder or Path())
    with shared.recording(study, "export", target):
        if for_r:
            from feel321.analysis.export import export_r
            from feel321.study.analyze import read_study_table

            table, seed = read_study_table(study)
            if "simulated" in table.rows and table.rows["simulated"].any():
                said = "ratings of simulated participants are among these"
                shared.warn(f"{said}; see the column simulated")
            export_r(table, target, rng=seed)
            shared.echo(f"{target}: next, in that folder: Rscript model.R")
            return
        from feel321.study.export.dataset import export_bids

        for line in export_bids(study, target, keep_ids=keep_ids, simulated=simulated):
            shared.warn(line)
    shared.echo(f"{target}: check it with: bids-validator-deno {target}")
