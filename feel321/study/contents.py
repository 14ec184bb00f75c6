"""What a study holds, read for Python: recordings, stimuli, plans, journals and ratings."""

from __future__ import annotations

import warnings
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from feel321.study.session.journal import utc_now

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path
    from typing import Self

    from pandas import DataFrame

    from feel321.analysis.table.reading import Table
    from feel321.stimuli.recording import Recording
    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.folder import StudyFolder
    from feel321.study.session.journal import Clock
    from feel321.study.settings.schema import Settings
    from feel321.types import Progress


@dataclass(frozen=True, slots=True, repr=False)
class Contents:
    """A study as far as it is read."""

    folder: StudyFolder
    progress: Progress = False
    now: Clock = utc_now
    warn: Callable[[str], None] | None = None

    def __repr__(self) -> str:
        """Write what a user would write to open it."""
        return f"{type(self).__name__}.open({str(self.folder.path)!r})"

    def _warn(self, message: str) -> None:
        if self.warn is None:
            warnings.warn(message, stacklevel=4)
        else:
            self.warn(message)

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

        Returns
        -------
        Study
            The same study.
        """
        from feel321.study.settings.edit import edit_settings

        edit_settings(self.folder.settings, changes)
        return self

    def recordings(self) -> list[Recording]:
        """Read the recordings that `study.toml` names.

        Returns
        -------
        list of Recording
            As the sensor gave them: not conditioned.
        """
        from feel321.study.settings.read import open_recordings

        return open_recordings(self.settings, self.folder.path)

    def stimuli(self) -> StimulusSet:
        """Read the stimulus set.

        Returns
        -------
        StimulusSet
            As it was built.
        """
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

        Returns
        -------
        DataFrame
            One row per judgement, in the order of the trials.
        """
        import pandas as pd

        from feel321.study.session.opening import PLAN_FILE
        from feel321.study.session.plan import list_codes, require_plan

        plan = require_plan(self._find(participant) / PLAN_FILE)
        rows = [
            {**asdict(trial), **asdict(judgement)}
            for trial in plan.trials
            for judgement in trial.judgements
        ]
        frame = pd.DataFrame(rows).drop(columns=["parts", "judgements"])
        if not blind:
            codes = {
                code: name for name, code in list_codes(self.stimuli(), seed=plan.seed).items()
            }
            columns = ["stimulus_id", "reference_id"]
            frame[columns] = frame[columns].replace(codes)
        return frame

    def journal(self, participant: str) -> DataFrame:
        """Read the journals of a participant.

        Parameters
        ----------
        participant : str
            The participant's code.

        Returns
        -------
        DataFrame
            One row per record: `session`, `sequence`, `utc`, `event`, `data`. Blind: stimuli have their codes.
        """
        import pandas as pd

        from feel321.study.session.journal import list_journals, read_journal

        rows = [
            (number, record.sequence, record.utc, record.event, dict(record.data))
            for number, path in enumerate(list_journals(self._find(participant)), start=1)
            for record in read_journal(path).records
        ]
        return pd.DataFrame(rows, columns=["session", "sequence", "utc", "event", "data"])

    def ratings(self) -> DataFrame:
        """Derive the ratings from the journals.

        Returns
        -------
        DataFrame
            One row per completed judgement, as `ratings.csv` holds them, which is written anew.
        """
        import pandas as pd

        from feel321.study.ratings import write_ratings

        write_ratings(self.folder, self.stimuli())
        return pd.read_csv(self.folder.ratings)

    def table(self) -> Table:
        """Join ratings and metrics for the analysis.

        Returns
        -------
        Table
            What every function of `feel321.analysis` takes.
        """
        from feel321.analysis.table.reading import read_table
        from feel321.study.settings.read import list_origins

        self.ratings()
        settings = self.settings
        return read_table(
            self.folder.ratings,
            self.folder.manifest,
            sources=list_origins(settings),
            metrics=settings.analysis.metrics,
        )

    def _find(self, participant: str) -> Path:
        known = {folder.name: folder for folder in self.folder.participants}
        if participant not in known:
            raise ValueError(
                f"participant must be one of {', '.join(known) or 'nobody yet'}; got {participant!r}"
            )
        return known[participant]
