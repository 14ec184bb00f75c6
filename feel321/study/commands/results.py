"""Verbs of what was found: analyze, audit, seal, export."""

from collections import defaultdict
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from feel321.study.commands import shared
from feel321.study.commands.shared import File, Json, Out, Rehearsals, Several
from feel321.study.folder import StudyFolder, require_study
from feel321.study.study import Study


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

    Fits the mixed models, correlations with two-way bootstrap intervals, contrasts of reducers, screening of raters
    and all else that the ratings allow. Writes index.html, results.json (every number of the page; --json prints it),
    tables/ and figures/ into STUDY/report. Metrics, bootstrap draws and margin of equivalence are declared in
    study.toml, [analysis]; which way a metric points, its bounds, label and unit in [metrics.NAME].

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

    A checkpoint is a commit in the git repository .evidence of the study: the SHA-256 and size of plans, journals,
    settings, texts, methods, stimuli, tables and report, never their contents. run, simulate, build, analyze and
    withdraw take one too. A remote that others cannot write to reveals every later change (feel321 audit); it may be a
    folder that is not there yet, and is kept if it takes this checkpoint.

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

    Writes a BIDS dataset for a repository: judgements, participants, stimuli, a description of every column, and the
    methods section. Participants get random numbers; personal answers, typed texts, notes, days and names of machines
    are left out. Authors and licence come from [publication] in study.toml.

    --r writes CSV files that R, JASP and jamovi read without options, and model.R, which fits the primary models with
    lme4 and prints their slopes beside those of feel321. They hold the study's codes of participants.

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
