"""Strength as participants matched it: `matches.csv`, and what it says of stimuli that should be equally strong.

`offset_db` says how much stronger than in the study a stimulus had to be played to be as strong as the recording
itself; 0 where the study's levels are right. Of each reducer it is averaged over a participant's recordings, then over
participants; the interval is Student's, over participants.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from statistics import fmean, stdev
from typing import TYPE_CHECKING, Any

from feel321.files import write_table
from feel321.protocols.blocks import SECOND, Matching
from feel321.protocols.trial import MATCHING
from feel321.study.session.codes import list_by_code
from feel321.study.session.events import TrialRated

if TYPE_CHECKING:
    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.folder import StudyFolder
    from feel321.study.session.plan import Dossier

MATCHES_FILE = "matches.csv"

COLUMNS = ("participant", "trial", "stimulus_id", "recording", "reducer", "level", "offset_db")


@dataclass(frozen=True, slots=True)
class MatchedStrength:
    """The offset of a reducer, in dB, with its 95 % interval; NaN where one participant is all there is."""

    reducer: str
    mean_db: float
    low_db: float
    high_db: float
    participants: int


def write_matches(study: StudyFolder, stimuli: StimulusSet) -> list[dict[str, Any]]:
    """Write all matches of a study, if it has or had any, and return them."""
    rows = [row for one in study.read_people() for row in list_matches(one, stimuli)]
    path = study.path / MATCHES_FILE
    if rows or path.exists():
        write_table(path, COLUMNS, rows, private=True)
        study.share(path)
    return rows


def list_matches(dossier: Dossier, stimuli: StimulusSet) -> Iterator[dict[str, Any]]:
    """List the matches of one participant that count, from the newest journal."""
    plan = dossier.plan
    if plan.matching is None:
        return
    matching, by_code = Matching(plan.matching, plan.trials), list_by_code(stimuli, seed=plan.seed)
    trials = {trial.number: trial for trial in plan.trials if trial.phase == MATCHING}
    for rated in dossier.records.find(TrialRated):
        if rated.trial not in trials or rated.rejected:
            continue
        stimulus = by_code[trials[rated.trial].judgements[0].stimulus_id]
        yield {
            "participant": plan.participant,
            "trial": rated.trial,
            "stimulus_id": stimulus.stimulus_id,
            "recording": stimulus.recording,
            "reducer": stimulus.reducer,
            "level": stimulus.level,
            "offset_db": round(matching.find_offset(rated.trial, float(rated.values[SECOND])), 3),
        }


def summarise_matches(rows: Iterable[Mapping[str, Any]]) -> list[MatchedStrength]:
    """Average matches by reducer, in the order of their names."""
    from scipy.stats import t

    own: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        own[row["reducer"]][row["participant"]].append(row["offset_db"])
    summary = []
    for reducer in sorted(own):
        means = [fmean(offsets) for offsets in own[reducer].values()]
        n, mean, half = len(means), fmean(means), math.nan
        if n > 1:
            half = float(t.ppf(0.975, n - 1)) * stdev(means) / math.sqrt(n)
        summary.append(MatchedStrength(reducer, mean, mean - half, mean + half, n))
    return summary


def describe_matches(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """Describe in one note how well strength was matched; nothing where it was not asked."""
    summary = summarise_matches(rows)
    if not summary:
        return []
    offsets = ", ".join(
        f"{one.reducer} {one.mean_db:+.1f} dB"
        + ("" if math.isnan(one.low_db) else f" ({one.low_db:+.1f} to {one.high_db:+.1f})")
        for one in summary
    )
    n = max(one.participants for one in summary)
    return [
        f"Strength matched by {n} participant{'s' * (n != 1)}: to feel as strong as the recording itself, stimuli had "
        f"to be played stronger by (95 % interval over participants) {offsets}. 0 dB means that the study's levels are "
        "right; 'original' is the recording matched with itself."
    ]
