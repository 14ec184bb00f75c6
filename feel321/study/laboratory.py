"""The verbs of a study that need its people or its rig: sessions, who takes part, devices."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

from feel321.doors import as_path, as_seed, follow
from feel321.study.folder import OpenStudy, Outcome, UsageError

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.study import options
    from feel321.study.session.ports import Place
    from feel321.study.settings.schema import Settings
    from feel321.study.status import Status


@dataclass(frozen=True, slots=True, repr=False)
class Laboratory(OpenStudy):
    """The verbs of a study that need its people or its rig; see `Study`."""

    @property
    def settings(self) -> Settings:
        """What `study.toml` says now, checked, with every default."""
        from feel321.study.settings.read import read_settings

        return read_settings(self.folder.settings)

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
        from feel321.study.evidence import freeze
        from feel321.study.session.opening import FROZEN_FILE
        from feel321.study.terminal import format_facts

        folder = self.folder
        if show:
            frozen = freeze.read_frozen(folder)
            changes = freeze.list_changes(folder, self.settings, frozen) if frozen else {}
        else:
            frozen, changes = freeze.freeze_study(folder, now=self.now)
        faults = freeze.find_faults(folder)
        for fault in faults:
            self.say(fault)
        lines = [f"{folder.path}: nothing is frozen; before the first session: feel321 freeze"]
        if frozen is not None:
            lines = [f"{folder.path / FROZEN_FILE}: frozen {frozen.utc}, SHA-256 {frozen.sha256}"]
        if frozen is not None and show:
            lines += format_facts({"hypotheses": frozen.hypotheses, "settings": frozen.settings})
        if changes:
            lines += ["changed:", *(f"  {one}" for one in changes.values())]
        facts = {"frozen": frozen and asdict(frozen), "changes": [*changes.values()]}
        return Outcome({**facts, "faults": faults}, lines)

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
        with SessionLog(participant, room.study.rig) as log:
            outcome = run_participant(
                room,
                participant,
                simulated=simulate_participant,
                seed=seed,
                on_step=log.note,
                warn=self.say,
            )
            log.end(outcome)
        return outcome

    def simulate(self, participants: options.People = 16, rng: options.Seed = None) -> DataFrame:
        """Run sessions with simulated participants, or resume them.

        Example: feel321 simulate my-study --participants 16 --seed 1

        Parameters
        ----------
        participants : int
            How many take part.
        rng : int or Generator, optional
            Random seed; the study's by default.
        """
        import pandas as pd

        self.lead_simulated(participants, rng)
        return pd.read_csv(self.folder.ratings)

    def lead_simulated(
        self, participants: options.People = 16, rng: options.Seed = None
    ) -> tuple[int, int]:
        """Do as `simulate`, without pandas, which takes a second to import; count participants and ratings."""
        from feel321.study.simulate import simulate_study

        if participants < 1:
            raise ValueError(f"participants must be 1 or more, got {participants}")
        seed = None if rng is None else as_seed(rng)
        with follow(self.progress, "simulate") as step:
            rows = simulate_study(
                self.folder, participants=participants, seed=seed, now=self.now, progress=step,
                warn=self.say,
            )  # fmt: skip
        return participants, rows

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
        from feel321.study.evidence.freeze import describe_frozen
        from feel321.study.status import read_status, watch_study

        folder = self.choose(rehearsals)
        if watch is not None:
            if notes:
                raise UsageError("--watch does not go with --notes; leave one out")
            from feel321.study.participants.traces import recording_output

            page = as_path(watch)
            with recording_output(folder, "status", page, now=self.now):
                watch_study(folder, page, now=self.now)
        with follow(self.progress, "status") as step:
            found = read_status(folder, progress=step)
        frozen = "" if rehearsals else describe_frozen(folder)
        return replace(found, frozen=frozen, shows_notes=notes)

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
        size, who = f"{found.size / 1e6:.1f} MB", ", ".join(found.participants)
        copied = f"{found.files} files ({size}) of {who}" if found.files else "nothing to copy"
        refused = [f"refused: {line}" for line in found.refused]
        lines = [f"{self.folder.path}: {copied}", *refused, *found.notes]
        return Outcome(asdict(found), lines, failed=bool(refused))

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
        from feel321.study.terminal import ask, is_answerable
        from feel321.study.withdrawal import release_participant, withdraw_participant

        folder, facts = self.folder, {"participant": participant}
        if keep_data:
            number = release_participant(folder, participant, now=self.now)
            line = f"{folder.path}: {participant} is released, number {number} is free"
            return Outcome({**facts, "number": number, "removed": []}, [line])
        if not is_sure:
            if not is_answerable():
                raise UsageError("no terminal to ask for confirmation; add --yes")
            question = f"Remove all data of {participant} in {folder.path} for good? [y/N]: "
            if ask(question) not in {"y", "yes"}:
                return Outcome(facts, [f"{folder.path}: nothing was removed"], failed=True)
        removed = withdraw_participant(
            folder, participant, now=self.now, reason=reason, warn=self.say
        )
        has_tombstone = (folder.sessions / participant).exists()
        kept = "; a tombstone keeps the code" if has_tombstone else ""
        line = (
            f"{folder.path}: removed {len(removed)} files of {participant}{kept}. "
            "Copies that feel321 did not make must be removed by hand"
        )
        return Outcome({**facts, "removed": removed, "tombstone": has_tombstone}, [line])
