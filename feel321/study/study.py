"""A study from Python or a notebook: what it holds, and the same steps as on the command line."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Self

from feel321.doors import as_path, as_seed, follow
from feel321.study.folder import (
    Audit,
    Problems,
    Seal,
    StudyFolder,
    UsageError,
    create_study,
    require_study,
)
from feel321.study.session.journal import Clock, utc_now

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.report.write import Results
    from feel321.analysis.table.items import Table
    from feel321.jobs import Workers
    from feel321.stimuli.recording import Recording
    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.power import StudyPower
    from feel321.study.settings.schema import Settings
    from feel321.study.status import Status
    from feel321.types import PathLike, Progress, Rng

    Numbers = int | Sequence[int]


@dataclass(frozen=True, slots=True, repr=False)
class Study:
    """A study in its folder; begin with `Study.create` or `Study.open`.

    Parameters
    ----------
    folder : StudyFolder
        Its places.
    progress : bool or callable
        Whether long steps show a progress bar.
    now : callable
        The clock.
    warn : callable, optional
        Called with each warning; Python's own warnings by default.

    Examples
    --------
    >>> import tempfile
    >>> from feel321 import study
    >>> pilot = study.Study.create(tempfile.mkdtemp() + "/pilot")
    >>> pilot.with_settings({"session.repeats": 2}).settings.session.repeats
    2
    >>> len(pilot.recordings())
    6
    """

    folder: StudyFolder
    progress: Progress = False
    now: Clock = utc_now
    warn: Callable[[str], None] | None = None

    @classmethod
    def create(cls, path: PathLike, *, like: str | None = None, methods: bool = False) -> Self:
        """Begin a study in a new folder: a commented `study.toml` that works as it is, and a `rig.toml`.

        Parameters
        ----------
        path : str or path
            The folder; refused if it holds a study.
        like : str, optional
            A ready study, such as `landin2010`, one that was published, or `generated`, a design.
        methods : bool
            Whether it gets an example of every kind of method of your own.
        """
        made = create_study(as_path(path), bundled=like)
        if methods:
            from feel321.study.settings.read import add_methods

            add_methods(made)
        return cls(made)

    @classmethod
    def open(cls, path: PathLike = ".", *, progress: Progress = False) -> Self:
        """Open a study that is there.

        Parameters
        ----------
        path : str or path
            The folder that holds `study.toml`.
        progress : bool or callable
            Whether long steps show a progress bar.
        """
        return cls(require_study(as_path(path)), progress)

    def check(self) -> Problems:
        """Check settings, recordings, texts, strength of the stimuli, rig and, once built, the stimulus set."""
        from feel321.study.freeze import describe_frozen, find_faults
        from feel321.study.workflow import check_study

        with follow(self.progress, "check") as step:
            found = check_study(self.folder, progress=step)
        frozen = filter(None, [describe_frozen(self.folder)])
        faults = find_faults(self.folder)
        return replace(found, warnings=(*found.warnings, *faults), notes=(*found.notes, *frozen))

    def build(self, workers: int | Workers = 1) -> StimulusSet:
        """Build the stimulus set; only what changed is made again.

        Example: feel321 build my-study --workers 2

        Parameters
        ----------
        workers : int or Workers
            Number of processes, or who else does the work.
        """
        from feel321.stimuli.sets.build import find_copies
        from feel321.study.workflow import build_study

        with follow(self.progress, "build") as step:
            facts, stimuli = build_study(self.folder, workers=workers, progress=step)
        noticed = [f"{one.name}: {text}" for one in facts for text in one.warnings]
        for text in (*noticed, *find_copies(facts)):
            self._warn(text)
        return stimuli

    def simulate(self, participants: int = 16, rng: Rng | None = None) -> DataFrame:
        """Run sessions with simulated participants, or resume them.

        Parameters
        ----------
        participants : int
            How many take part.
        rng : int or Generator, optional
            Random seed of the participants; the study's by default.
        """
        import pandas as pd

        from feel321.study.simulation import simulate_study

        if participants < 1:
            raise ValueError(f"participants must be 1 or more, got {participants}")
        seed = None if rng is None else as_seed(rng)
        with follow(self.progress, "simulate") as step:
            simulate_study(
                self.folder, participants=participants, seed=seed, now=self.now, progress=step,
                warn=self._warn,
            )  # fmt: skip
        return pd.read_csv(self.folder.ratings)

    def status(self) -> Status:
        """Read how far every participant has come, and how balanced the design is so far. Blind."""
        from feel321.study.status import read_status

        with follow(self.progress, "status") as step:
            return read_status(self.folder, progress=step)

    def analyze(
        self,
        *,
        ratings: PathLike | None = None,
        manifest: PathLike | None = None,
        out: PathLike | None = None,
        metrics: Sequence[str] = (),
        draws: int | None = None,
    ) -> Results:
        """Relate the ratings to the match metrics and write the report.

        Writes index.html, results.json (every number of the page; --json prints it), tables/ and figures/ into
        STUDY/report. Metrics, bootstrap draws and margin of equivalence are declared in study.toml, [analysis].

        Example: feel321 analyze my-study
                 feel321 analyze --ratings ratings.csv --manifest manifest.csv --out report
                 feel321 analyze --ratings ratings.csv --manifest manifest.csv --metric roughness_match

        Parameters
        ----------
        ratings : str or path, optional
            Ratings from elsewhere; needs a manifest outside a study.
        manifest : str or path, optional
            The stimuli rated.  [default: the study's]
        out : str or path, optional
            Where to, instead of report/.
        metrics : sequence of str
            A numeric manifest column to analyze; repeatable.  [default: as declared]
        draws : int, optional
            Bootstrap draws per interval; as study.toml declares by default.
        """
        from feel321.study.analyze import analyze_study
        from feel321.study.export.dataset import write_methods
        from feel321.study.persons.withdrawal import recording_output

        if manifest is not None and ratings is None:
            raise UsageError("--manifest needs --ratings; give both, or --ratings alone in a study")
        if ratings is not None and manifest is None and not self.folder.settings.is_file():
            raise UsageError(
                "--ratings needs the table of the stimuli that were rated: add --manifest FILE, or name the study first"
            )
        target = self.folder.report if out is None else as_path(out)
        recording = recording_output(self.folder, "analyze", target, now=self.now)
        with recording, follow(self.progress, "analyze") as step:
            return analyze_study(
                self.folder,
                ratings=None if ratings is None else as_path(ratings),
                manifest=None if manifest is None else as_path(manifest),
                metrics=metrics or None,
                draws=draws,
                out=None if out is None else target,
                progress=step,
                finish=partial(write_methods, self.folder) if ratings is None else None,
            )

    def audit(self, *, remotes: Sequence[str] = (), expect: str = "") -> Audit:
        """Verify plans, journals and stimuli; list every change.

        Compares the journals with plans and tables, and the files with the checkpoints in .evidence and at its
        remotes. What no checkpoint covers is not judged: recordings, personal answers, other results.

        Example: feel321 audit my-study
                 feel321 audit my-study --remote /media/usb/evidence.git
                 feel321 audit my-study --expect 5f0c2a7e91d4

        Parameters
        ----------
        remotes : sequence of str
            A further git remote with checkpoints; repeatable.
        expect : str
            Fail without this checkpoint.
        """
        from feel321.study.auditing.study import examine

        with follow(self.progress, "audit") as step:
            return examine(self.folder, expect=expect, remotes=remotes, progress=step)

    def seal(self, reason: str = "", *, to: str = "") -> Seal:
        """Take a checkpoint of the study, and push it to its remotes.

        A checkpoint is a commit in the git repository .evidence of the study: digests of its files, never their
        contents. A remote that others cannot write to reveals every later change (feel321 audit); it may be a folder
        that is not there yet, and is kept if it takes this checkpoint.

        Example: feel321 seal my-study
                 feel321 seal my-study --to /mnt/elsewhere/my-study.git
                 feel321 seal my-study --reason "analysis.draws raised, as preregistered"

        Parameters
        ----------
        reason : str
            Why settings, texts or methods changed.
        to : str
            Git remote to push to from now on: a folder outside the study, or a URL.
        """
        from feel321.study.checkpoints import take_checkpoint

        return take_checkpoint(self.folder, "seal", reason=reason, remote=to, now=self.now)

    def power(  # noqa: PLR0913 - every choice that changes the answer has a name of its own
        self,
        *,
        participants: Numbers = (),
        recordings: Numbers = (),
        reducers: Numbers = (),
        repeats: Numbers = (),
        effects: Mapping[str, float] | Sequence[str] = (),
        pilot: str | None = None,
        wanted: float = 0.8,
        studies: int = 1000,
        workers: int | Workers = 1,
        seed: int | None = None,
        out: PathLike | None = None,
    ) -> StudyPower:
        """Find how many participants, recordings and reducers a study needs.

        Simulates this very study: its stimuli, protocols, primary model and Holm's method. Writes a page, tables
        and JSON into STUDY/power.

        Example: feel321 power my-study --participants 8,12,16,24 --effect spectral_match_bounded=2 --workers 2

        Parameters
        ----------
        participants : int or sequence of int
            Numbers of participants.  [default: 8 to 48]
        recordings : int or sequence of int
            Numbers of recordings.  [default: half to three times the study's]
        reducers : int or sequence of int
            Numbers of reducers.  [default: half to 1.5 times the study's]
        repeats : int or sequence of int
            Ratings of each stimulus by one person.  [default: 1 to 4]
        effects : Mapping of str to float, or sequence of str
            Slope to plan for, in points per +0.1 of a match, or per power of ten (+1 dB) of other metrics;
            repeatable; ATTRIBUTE/METRIC for one scale.  [default: as simulated observers feel]
        pilot : str, optional
            Ratings to take standard deviations from; 'study': its own.  [default: published ones]
        wanted : float
            Target power.
        studies : int
            Simulated studies of each checked design; 0: closed form only.
        workers : int or Workers
            Number of processes, or who else does the work.
        seed : int, optional
            Random seed; the study's by default.
        out : str or path, optional
            Where to, instead of power/.
        """
        from feel321.analysis.report.folder import check_target
        from feel321.jobs import as_workers
        from feel321.study import power
        from feel321.study.analyze import measure_declared
        from feel321.study.persons.withdrawal import recording_output

        target = self.folder.path / "power" if out is None else as_path(out, "out")
        check_target(target)
        sizes = {
            "participants": participants,
            "recordings": recordings,
            "reducers": reducers,
            "repeats": repeats,
        }
        recording = recording_output(self.folder, "power", target, now=self.now)
        with recording, follow(self.progress, "power") as step:
            further = measure_declared(self.folder, self.settings)
            task = power.set_up(
                self.folder, effects=effects, pilot=pilot, wanted=wanted, further=further
            )
            found = power.plan_study(
                task,
                sizes,
                studies=studies,
                seed=self.settings.study.seed if seed is None else seed,
                workers=as_workers(workers),
                progress=step,
            )
            return replace(found, path=found.write(target).parent)

    @property
    def settings(self) -> Settings:
        """What `study.toml` says now, checked, with every default."""
        from feel321.study.settings.read import read_settings

        return read_settings(self.folder.settings)

    def with_settings(self, changes: Mapping[str, object]) -> Self:
        """Change settings in `study.toml`, which keeps its comments; a wrong one changes nothing.

        Parameters
        ----------
        changes : Mapping of str to object
            Dotted name -> value, such as `{"session.repeats": 2}`; None brings the default back.
        """
        from feel321.study.settings.read import edit_settings

        edit_settings(self.folder.settings, changes)
        return self

    def recordings(self) -> list[Recording]:
        """Read the recordings that `study.toml` names."""
        from feel321.study.settings.read import open_recordings

        return open_recordings(self.settings, self.folder.path)

    def stimuli(self) -> StimulusSet:
        """Read the stimulus set."""
        from feel321.stimuli.sets.manifest import read_stimuli

        return read_stimuli(self.folder.stimuli)

    def ratings(self) -> DataFrame:
        """Derive the ratings from the journals."""
        import pandas as pd

        from feel321.study.ratings import write_ratings

        write_ratings(self.folder, self.stimuli())
        return pd.read_csv(self.folder.ratings)

    def table(self) -> Table:
        """Join ratings and metrics for the analysis."""
        from feel321.study.analyze import read_study_table

        return read_study_table(self.folder)

    def __repr__(self) -> str:
        """Write what a user would write to open it."""
        return f"{type(self).__name__}.open({str(self.folder.path)!r})"

    def _warn(self, message: str) -> None:
        if self.warn is None:
            warnings.warn(message, stacklevel=4)
        else:
            self.warn(message)
