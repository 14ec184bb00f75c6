# pylint: disable=too-many-lines  # one verb a method: more than half is the help of the command line
"""A study from Python or a notebook: what it holds, and every verb of the command line that works on one.

A study is opened once and passed on: its folder reads each plan and journal once. `feel321.study.cli` makes the verbs
of these methods: their options from the signatures, their help from the docstrings. What takes more than a few lines to
do is in the module that does it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Self

from feel321.arguments import as_names, as_path, as_seed, follow
from feel321.jobs import as_workers
from feel321.study.folder import (
    OpenStudy,
    Outcome,
    Problems,
    UsageError,
    create_study,
    require_study,
)

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.report.write import Results
    from feel321.analysis.table.items import Table
    from feel321.stimuli.recording import Recording
    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study import options
    from feel321.study.folder import Audit, Seal
    from feel321.study.power import StudyPower
    from feel321.study.session.ports import Place
    from feel321.study.settings.schema import Settings
    from feel321.study.status import Status
    from feel321.types import PathLike, Progress


@dataclass(frozen=True, slots=True, repr=False)
class Study(OpenStudy):
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
            Whether to add an example of every kind of method of your own.
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

    def check(self, *, method: options.Name = None, kind: options.Kind = None) -> Problems:
        """Check everything that a study needs.

        Settings, recordings, texts, strength of the stimuli, rig and stimulus set: every problem is listed at once.
        With --method: whether a reducer or metric of your own meets feel321's requirements.

        Example: feel321 check my-study
                 feel321 check --method mylab.haptics:my321
                 feel321 check my-study --method methods/snr.py:snr --kind metric

        Parameters
        ----------
        method : str, optional
            Your own method instead: mylab:my321, methods/my321.py:my321, or its table's name.
        kind : str, optional
            What the method is; found out if left out.
        """
        from feel321.study.check import check_own_method, check_study
        from feel321.study.evidence.freeze import describe_frozen, find_faults

        if method is not None:
            return check_own_method(method, self.folder.path, kind)
        require_study(self.folder.path)
        with follow(self.progress, "check") as step:
            found = check_study(self.folder, progress=step)
        frozen = filter(None, [describe_frozen(self.folder)])
        faults = find_faults(self.folder)
        return replace(found, warnings=(*found.warnings, *faults), notes=(*found.notes, *frozen))

    def build(self, workers: options.Crew = 1, *, scheduler: options.Scheduler = "") -> StimulusSet:
        """Build the stimulus set; only what changed is rebuilt.

        Example: feel321 build my-study --workers 2

        Parameters
        ----------
        workers : int or Workers
            Number of processes.
        scheduler : str
            A Dask cluster instead: tls://HOST:PORT, or tcp://HOST:PORT (whoever reaches it can run programs).
        """
        from feel321.study.check import build_study, find_copies

        with follow(self.progress, "build") as step:
            facts, stimuli = build_study(
                self.folder, workers=as_workers(workers, scheduler), progress=step
            )
        noticed = [f"{one.name}: {text}" for one in facts for text in one.warnings]
        for text in (*noticed, *find_copies(facts)):
            self.say(text)
        return stimuli

    def power(  # noqa: PLR0913 - every choice that changes the answer has a name of its own
        self,
        *,
        participants: options.Numbers = (),
        recordings: options.Numbers = (),
        reducers: options.Numbers = (),
        repeats: options.Numbers = (),
        effects: options.Effects = (),
        pilot: options.Pilot = None,
        wanted: options.Power = 0.8,
        studies: options.Studies = 1000,
        workers: options.Crew = 1,
        scheduler: options.Scheduler = "",
        seed: options.WholeSeed = None,
        out: options.Out = None,
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
            Number of processes.
        scheduler : str
            A Dask cluster instead: tls://HOST:PORT, or tcp://HOST:PORT (whoever reaches it can run programs).
        seed : int, optional
            Random seed; the study's by default.
        out : str or path, optional
            Folder of the results, instead of power/.
        """
        from feel321.analysis.report.folder import check_target
        from feel321.study import power
        from feel321.study.analyze import measure_declared
        from feel321.study.participants.traces import recording_output

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
                workers=as_workers(workers, scheduler),
                progress=step,
            )
            return replace(found, path=found.write(target).parent)

    def calibrate(self, *, device: options.Name = None, manual: options.Gains = ()) -> Outcome:
        """Measure the coils of the rig and make filters for them.

        Plays sweeps on one coil after another, recorded by the sensor of rig.toml; proposes the band and the gain of
        each filter, says what that costs in level, and asks; verifies the filters by playing through them, and stores a
        certificate, of which run uses the newest that is valid. Ctrl-C stops. The exit code is 1 if the limits of
        [calibration] in rig.toml are not met; run does not use such a certificate.

        Example: feel321 calibrate my-study

        Parameters
        ----------
        device : str, optional
            Device instead of the rig's: its name, or a unique part of it.
        manual : sequence of str
            Gain of an actuator in m/s² at full scale, instead of measuring; once for each.
        """
        from feel321.study.actuator.calibrate import calibrate_rig

        return calibrate_rig(self, device=device, manual=manual)

    def doctor(self, *, device: options.Name = None, seconds: options.Seconds = 5.0) -> Outcome:
        """Test the rig: list devices, measure latency and jitter, try each coil.

        Plays quiet pulses on every actuator through the same stream as in a session and, with a sensor, a probe on
        each coil. Reports coils that are dead, inverted, swapped, loose or too strong for the certificate or rig.toml,
        a wrong rate, a missing channel, and hum; the exit code is then 1. Without a study, --device names what to play
        on.

        Example: feel321 doctor my-study --seconds 10

        Parameters
        ----------
        device : str, optional
            Device instead of the rig's: its name, or a unique part of it.
        seconds : float
            Duration of the pulse train, in s.
        """
        from feel321.study.actuator.doctor import examine_study_rig

        return examine_study_rig(self, device=device, seconds=seconds)

    def freeze(self, *, show: bool = False) -> Outcome:
        """Freeze hypotheses, design and analysis before the first session of a person.

        Writes frozen.json: settings, stimuli, code and hypotheses, with their digests. analyze then marks results as
        confirmatory or exploratory, and names every setting that was changed. It may be written again until a person's
        session has begun. No rating is shown.

        Example: feel321 freeze my-study
                 feel321 freeze my-study --show

        Parameters
        ----------
        show : bool
            Only show what is frozen and what changed.
        """
        from feel321.study.evidence.freeze import report_frozen

        return report_frozen(self, show=show)

    def run(  # noqa: PLR0913 - one parameter per option
        self,
        *,
        participant: options.NewCode,
        windowed: bool = False,
        screen: options.Screen = 0,
        device: options.Name = None,
        accept_rig: bool = False,
        lsl: bool = False,
        rehearse: bool = False,
        simulate_participant: bool = False,
        seed: options.WholeSeed = None,
    ) -> Place:
        """Run a session with a participant, or resume it.

        Example: feel321 run my-study --participant p07

        Parameters
        ----------
        participant : str
            The participant's code.
        windowed : bool
            A window instead of the whole screen.
        screen : int
            The participant's monitor; 0: the main one.
        device : str, optional
            Instead of the rig's; 'file' writes WAV files.
        accept_rig : bool
            Resume although the rig or its certificate has changed; the journal records it.
        lsl : bool
            Send onsets to the lab streaming layer.
        rehearse : bool
            Rehearse: the session is stored in rehearsals/ and never analysed.
        simulate_participant : bool
            A simulated participant presses keys.
        seed : int, optional
            Seed of the simulated participant; the study's by default.
        """
        if seed is not None and not simulate_participant:
            raise UsageError("--seed needs --simulate-participant; people have no seed")
        from feel321.study.run import SessionLog, run_participant
        from feel321.study.sessions import read_room

        room = read_room(self.choose(rehearse), now=self.now)
        room = replace(room, windowed=windowed, screen=screen, device=device)
        room = replace(room, accept_rig=accept_rig, lsl=lsl)
        run = partial(run_participant, room, participant, simulated=simulate_participant)
        log = SessionLog(participant, room.study.rig)
        return log.lead(partial(run, seed=seed, warn=self.say))

    def simulate(self, participants: options.People = 16, rng: options.Seed = None) -> Outcome:
        """Run sessions with simulated participants, or resume them.

        Example: feel321 simulate my-study --participants 16 --seed 1

        Parameters
        ----------
        participants : int
            How many take part.
        rng : int or Generator, optional
            Random seed; the study's by default.
        """
        from feel321.study.simulate import report_simulated

        if participants < 1:
            raise ValueError(f"participants must be 1 or more, got {participants}")
        return report_simulated(self, participants, None if rng is None else as_seed(rng))

    def status(
        self, *, notes: bool = False, watch: options.Page | None = None, rehearsals: bool = False
    ) -> Status:
        """Show the progress of every participant, without naming a condition.

        Example: feel321 status my-study
                 feel321 status my-study --watch sessions.html

        Parameters
        ----------
        notes : bool
            Also the experimenter's notes.
        watch : str or path, optional
            Write the progress to a page, renewed until Ctrl-C.
        rehearsals : bool
            Rehearsals instead of sessions.
        """
        from feel321.study.status import read_status, watch_study

        folder = self.choose(rehearsals)
        if watch is not None:
            if notes:
                raise UsageError("--watch does not go with --notes; leave one out")
            watch_study(folder, as_path(watch), now=self.now)
        with follow(self.progress, "status") as step:
            found = read_status(folder, progress=step)
        if folder.frozen.exists() and not rehearsals:
            from feel321.study.evidence.freeze import describe_frozen

            found = replace(found, frozen=describe_frozen(folder))
        return replace(found, shows_notes=notes)

    def note(
        self, text: options.Text, *, participant: options.Code, rehearsals: bool = False
    ) -> Outcome:
        """Write an experimenter's note into a participant's journal.

        One line, not while a session runs. It is never edited, and removed only by withdraw: write no names. Shown by
        status --notes.

        Example: feel321 note my-study --participant p07 "left coil rattled in block 2"

        Parameters
        ----------
        text : str
            The note.
        participant : str
            The participant's code.
        rehearsals : bool
            Rehearsals instead of sessions.
        """
        from feel321.study.withdrawal import take_note

        notice = take_note(self.choose(rehearsals), participant, text, now=self.now)
        if notice:
            self.say(notice)
        facts = {"participant": participant, "text": text, "warning": notice}
        return Outcome(facts, [f"{participant}: noted"])

    def collect(self, *sources: options.Sources) -> Outcome:
        """Collect the sessions of other stations into one study.

        FROM are study folders, mounted or copied; they are only read. A longer journal takes the place of one that it
        continues; sessions that conflict with the study are refused by name. A participant who withdrew at one station
        is withdrawn here.

        Example: feel321 collect /mnt/lab2/my-study /media/usb/my-study --into my-study

        Parameters
        ----------
        *sources : str or path
            The study folders of other stations.
        """
        from feel321.study.collect import collect_sessions

        paths = [as_path(one) for one in sources]
        with follow(self.progress, "collect") as step:
            found = collect_sessions(self.folder, paths, now=self.now, progress=step)
        return found.report(self.folder)

    def withdraw(
        self,
        *,
        participant: options.Code,
        reason: str = "",
        keep_data: bool = False,
        is_sure: options.Yes = False,
    ) -> Outcome:
        """Remove the data of a participant for good, and free the design slot.

        Data go from sessions, rehearsals, tables and results; outputs elsewhere are listed, to be removed by hand. The
        code is not reused. --keep-data, for somebody who will not return: what was recorded stays, the next participant
        gets the slot.

        Example: feel321 withdraw my-study --participant p07 --yes
                 feel321 withdraw my-study --participant p07 --keep-data

        Parameters
        ----------
        participant : str
            The participant's code.
        reason : str
            Kept with the code; write no name.
        keep_data : bool
            Only free the design slot.
        is_sure : bool
            Do not ask.
        """
        from feel321.study.withdrawal import report_leaving

        return report_leaving(self, participant, reason, keep_data=keep_data, is_sure=is_sure)

    def analyze(
        self,
        *,
        ratings: options.File | None = None,
        manifest: options.File | None = None,
        out: options.Out = None,
        metrics: options.Metrics = (),
        draws: options.PythonOnly = None,
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
            Folder of the report, instead of report/.
        metrics : sequence of str
            A numeric manifest column to analyze; repeatable.  [default: as declared]
        draws : int, optional
            Bootstrap draws per interval; as study.toml declares by default.
        """
        from feel321.study.analyze import analyze_study
        from feel321.study.export import write_methods
        from feel321.study.participants.traces import recording_output

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

    def audit(
        self,
        *,
        remotes: options.Remotes = (),
        expect: options.Checkpoint = "",
        rehearsals: bool = False,
    ) -> Audit:
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
            Fail if this checkpoint is missing.
        rehearsals : bool
            Rehearsals instead of sessions.
        """
        from feel321.study.evidence.audit import examine

        urls = as_names(remotes, "remotes")
        with follow(self.progress, "audit") as step:
            return examine(self.choose(rehearsals), expect=expect, remotes=urls, progress=step)

    def seal(self, reason: str = "", *, to: options.Remote = "") -> Seal:
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
        from feel321.study.evidence.checkpoints import take_checkpoint

        return take_checkpoint(self.folder, "seal", reason=reason, remote=to, now=self.now)

    def export(
        self, target: options.Folder, *, simulated: bool = False, for_r: options.ForR = False
    ) -> Outcome:
        """Write a study's data for others, into the folder DIR.

        Writes a BIDS dataset for a repository: participants get random numbers; answers to question pages, notes, days
        and names of machines are left out. --r writes CSV files for R, JASP and jamovi, with the study's codes of
        participants, and model.R, which fits the primary models with lme4.

        Example: feel321 export my-study dataset
                 feel321 export my-study for-r --r

        Parameters
        ----------
        target : str or path
            The folder to write.
        simulated : bool
            Include simulated participants, marked as such.
        for_r : bool
            Write CSV files for R and JASP instead.
        """
        from feel321.study.export import export_study

        if for_r and simulated:
            raise UsageError("--simulated is for BIDS; leave it out with --r")
        return export_study(self, as_path(target), simulated=simulated, for_r=for_r)

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
