"""A study from Python or a notebook: what it holds, and the same steps as on the command line."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Self

from feel321.doors import as_path, as_seed, follow
from feel321.study.folder import StudyFolder, create_study, require_study
from feel321.study.session.journal import Clock, utc_now

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.report.write import Results
    from feel321.analysis.table.items import Table
    from feel321.jobs import Workers
    from feel321.stimuli.recording import Recording
    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.findings import Audit, Problems, Seal
    from feel321.study.power import StudyPower
    from feel321.study.session.plan import Dossier
    from feel321.study.settings.schema import Settings
    from feel321.study.status import Status
    from feel321.types import PathLike, Progress, Rng


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

    def build(self, workers: int | Workers = 1, *, page: bool = True) -> StimulusSet:
        """Build the stimulus set; only what changed is made again.

        Parameters
        ----------
        workers : int or Workers
            Number of processes, or who else does the work.
        page : bool
            Whether the set gets a page on which stimuli are seen, measured and heard, `stimuli/index.html`.
        """
        from feel321.stimuli.sets.build import find_copies
        from feel321.study.workflow import build_study

        with follow(self.progress, "build") as step:
            facts, stimuli = build_study(self.folder, workers=workers, page=page, progress=step)
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

        self.simulate_sessions(participants, None if rng is None else as_seed(rng))
        return pd.read_csv(self.folder.ratings)

    def simulate_sessions(self, participants: int, seed: int | None = None) -> int:
        """Do as `simulate`, without pandas, which takes a second to import.

        Parameters
        ----------
        participants : int
            How many take part.
        seed : int, optional
            Random seed of the participants; the study's by default.
        """
        from feel321.study.simulation import simulate_study

        if participants < 1:
            raise ValueError(f"participants must be 1 or more, got {participants}")
        with follow(self.progress, "simulate") as step:
            return simulate_study(
                self.folder,
                participants=participants,
                seed=seed,
                now=self.now,
                progress=step,
                warn=self._warn,
            )

    def status(self) -> Status:
        """Read how far every participant has come, and how balanced the design is so far. Blind."""
        from feel321.study.status import read_status

        with follow(self.progress, "status") as step:
            return read_status(self.folder, progress=step)

    def analyze(
        self,
        draws: int | None = None,
        *,
        rivals: bool = False,
        metrics: Sequence[str] = (),
        ratings: PathLike | None = None,
        manifest: PathLike | None = None,
        out: PathLike | None = None,
    ) -> Results:
        """Relate the ratings to the match metrics and write the report into `report/`.

        Parameters
        ----------
        draws : int, optional
            Bootstrap draws per interval; as `study.toml` declares by default.
        rivals : bool
            Also say which of all metrics predicts best, corrected for how many were tried.
        metrics : sequence of str
            Numeric columns of the manifest to analyze; those that `study.toml` declares if left out.
        ratings, manifest : str or path, optional
            Ratings from elsewhere, and the stimuli that were rated; the study's by default.
        out : str or path, optional
            Where to, instead of `report/`.
        """
        from feel321.study.analyze import analyze_study
        from feel321.study.export.narrative import write_methods

        with follow(self.progress, "analyze") as step:
            return analyze_study(
                self.folder,
                ratings=None if ratings is None else as_path(ratings),
                manifest=None if manifest is None else as_path(manifest),
                metrics=metrics or None,
                draws=draws,
                rivals=rivals,
                out=None if out is None else as_path(out),
                progress=step,
                finish=partial(write_methods, self.folder) if ratings is None else None,
            )

    def audit(self, *, expect: str = "", remotes: Sequence[str] = ()) -> Audit:
        """Verify plans, journals, stimuli and tables, and compare all files with the checkpoints.

        Parameters
        ----------
        expect : str
            The id of a checkpoint that must be there, or how it begins.
        remotes : sequence of str
            Git remotes with checkpoints, folders or URLs, besides those that the study is pushed to.
        """
        from feel321.study.auditing.study import examine

        with follow(self.progress, "audit") as step:
            return examine(self.folder, expect=expect, remotes=remotes, progress=step)

    def seal(self, reason: str = "", *, to: str = "") -> Seal:
        """Record the digests of all files as a checkpoint, and push it to the remotes.

        Parameters
        ----------
        reason : str
            Why settings, texts or methods were changed since the last checkpoint.
        to : str
            A further git remote, a folder or a URL; it is kept if it takes this checkpoint.
        """
        from feel321.study.checkpoints import take_checkpoint

        return take_checkpoint(self.folder, "seal", reason=reason, remote=to, now=self.now)

    def power(  # noqa: PLR0913 - every choice that changes the answer has a name of its own
        self,
        *,
        participants: int | Sequence[int] = (),
        recordings: int | Sequence[int] = (),
        reducers: int | Sequence[int] = (),
        repeats: int | Sequence[int] = (),
        effects: Mapping[str, float] | None = None,
        hypothesis: str | None = None,
        pilot: str | None = None,
        manifest: PathLike | None = None,
        wanted: float = 0.8,
        studies: int = 1000,
        workers: int | Workers = 1,
        seed: int | None = None,
        folder: PathLike | None = None,
    ) -> StudyPower:
        """Find how many participants, recordings and reducers the study needs, and write the page into `power/`.

        Parameters
        ----------
        participants, recordings, reducers, repeats : int or sequence of int
            Numbers that are compared; around the study's own if left out.
        effects : Mapping of str to float, optional
            Metric, or attribute/metric (which goes first) -> slope to plan for, in points per step of the metric: +0.1
            of a match, a power of ten of metrics in dB or without bounds (the result names it). As the study's
            simulated observers feel if left out; 0 for metrics that they do not feel.
        hypothesis : str, optional
            Attribute/metric that the recommended design is for; the one of `effects` with the least power if left out.
        pilot : str, optional
            Table of ratings to take standard deviations from, or "study" for the study's own; the usual ones of
            `analysis.Truth` if left out.
        manifest : str or path, optional
            The stimuli of the pilot; the study's by default.
        wanted : float
            Power that is asked for.
        studies : int
            Simulated studies of each checked design; 0 for the closed form alone.
        workers : int or Workers
            Number of processes, or who else does the work. The result does not depend on it.
        seed : int, optional
            Random seed; the study's by default.
        folder : str or path, optional
            Where to, instead of `power/`.
        """
        from feel321.analysis.report.folder import check_target
        from feel321.jobs import as_workers
        from feel321.study import power

        target = self.folder.path / "power" if folder is None else as_path(folder, "folder")
        check_target(target)
        given = None if manifest is None else as_path(manifest, "manifest")
        seed = self.settings.study.seed if seed is None else seed
        with follow(self.progress, "power") as step:
            task = power.set_up(
                self.folder, effects=effects, pilot=pilot, pilot_manifest=given, wanted=wanted
            )
            found = power.plan_study(
                task, participants=participants, recordings=recordings, reducers=reducers, repeats=repeats,
                hypothesis=hypothesis or "", studies=studies, seed=seed, keep=target / power.KEPT,
                workers=as_workers(workers), progress=step,
            )  # fmt: skip
        found.write(target)
        return found

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

    def plan(self, participant: str, *, blind: bool = True) -> DataFrame:
        """Read the plan of a participant.

        Parameters
        ----------
        participant : str
            The participant's code.
        blind : bool
            Whether stimuli keep their codes; if False, they are named.
        """
        import pandas as pd

        from feel321.study.session.plan import list_codes

        plan = self._find(participant).plan
        rows = [
            {**asdict(trial), **asdict(judgement), "scale": judgement.scale or trial.scale}
            for trial in plan.trials
            for judgement in trial.judgements
        ]
        frame = pd.DataFrame(rows).drop(columns=["parts", "judgements"])
        if not blind:
            named = list_codes(self.stimuli(), seed=plan.seed)
            codes = {code: name for name, code in named.items()}
            columns = ["stimulus_id", "reference_id"]
            frame[columns] = frame[columns].replace(codes)
        return frame

    def journal(self, participant: str) -> DataFrame:
        """Read the journals of a participant.

        Parameters
        ----------
        participant : str
            The participant's code.
        """
        import pandas as pd

        rows = [
            (number, record.sequence, record.utc, record.event, dict(record.data))
            for number, chain in enumerate(self._find(participant).chains, start=1)
            for record in chain.records
        ]
        return pd.DataFrame(rows, columns=["session", "sequence", "utc", "event", "data"])

    def ratings(self) -> DataFrame:
        """Derive the ratings from the journals."""
        import pandas as pd

        from feel321.study.ratings import write_ratings

        write_ratings(self.folder, self.stimuli())
        return pd.read_csv(self.folder.ratings)

    def answers(self) -> DataFrame:
        """Derive the answers to question pages from the journals; personal ones are marked so."""
        import pandas as pd

        from feel321.study.persons.answers import COLUMNS, write_answers

        return pd.DataFrame(write_answers(self.folder), columns=list(COLUMNS))

    def table(self) -> Table:
        """Join ratings and metrics for the analysis."""
        from feel321.study.analyze import read_study_table

        return read_study_table(self.folder)[0]

    def __repr__(self) -> str:
        """Write what a user would write to open it."""
        return f"{type(self).__name__}.open({str(self.folder.path)!r})"

    def _warn(self, message: str) -> None:
        if self.warn is None:
            warnings.warn(message, stacklevel=4)
        else:
            self.warn(message)

    def _find(self, participant: str) -> Dossier:
        known = {folder.name: folder for folder in self.folder.participants}
        if participant not in known:
            listed = ", ".join(known) or "nobody yet"
            raise ValueError(f"participant must be one of {listed}; got {participant!r}")
        return self.folder.read_person(known[participant])
