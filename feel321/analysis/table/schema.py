"""Columns that the tables may have: their meaning, unit and kind, and which of them must be there.

Conventions: names are matched exactly. A column that is spelt almost like one of these is refused, because it would
otherwise be passed over; any other column is not used, and is named in the report's notes.

Names of metrics, tasks and columns that other packages define are repeated here as data, so that a table is read
without them; tests compare both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

LOWEST, HIGHEST = 0.0, 100.0
"""The ends of every rating scale."""

LARGEST = 1e12
"""No metric is larger in size; squares of much larger numbers are no numbers any more."""

PAIRED, ANSWERED = "dissimilarity", "abx"
APART = (PAIRED, ANSWERED)
"""Scales that enter no association: a metric describes one stimulus, and is larger or smaller."""

ROLES = ("test", "reference", "anchor")
PAIR = "pair"
"""Role of a stimulus that is rated against another one than the reference."""

SURFACE = "surface"
"""Reference of a judgement that compares with the real surface."""

NAMING = ("recording", "reducer", "level")
"""Columns that together name a stimulus where there is no stimulus_id."""

IDENTITY = ("stimulus_id", "recording", "reducer")
AMPLITUDE, GAIN, SENSATION = "rms_m_s2", "gain", "sensation_level_db"

YES = frozenset({"true", "1", "yes"})
NO = frozenset({"false", "0", "no", ""})

PLANNED = ("spectral_match_bounded", "temporal_match")
"""Metrics of the primary analysis unless others are declared."""

STAND_INS = {"spectral_match_bounded": "spectral_match"}
"""Used for a planned metric that a manifest does not have."""

MATCHES = {
    "spectral_match": "eq. 1 of Landin et al. 2010, which has no lower bound",
    "temporal_match": "how well a stimulus matches its recording",
    "spectral_match_bounded": "how well a stimulus matches its recording",
}
"""Match metrics of feel321, and what they are in words."""

REDUCERS = (
    "sax321", "say321", "saz321", "soc321", "mag321", "pca321", "pca321_adaptive", "dft321", "dft321_windowed",
    "dft321_principal", "dft321_principal_windowed", "sax321_matched", "say321_matched", "saz321_matched",
    "pca321_matched", "sax321_matched_running", "say321_matched_running", "saz321_matched_running",
    "pca321_matched_windowed",
)  # fmt: skip
"""Reducers of feel321, in the order of `feel321.stimuli.REDUCERS`."""


@dataclass(frozen=True, slots=True)
class ColumnInfo:
    """A column of a table; its kind is one of `feel321.analysis.table.sheet.KINDS`, or empty for plain text."""

    meaning: str
    unit: str = ""
    kind: str = ""
    needed: bool = False
    used: bool = True


RATINGS: Mapping[str, ColumnInfo] = {
    "participant": ColumnInfo("who judged", kind="name", needed=True),
    "session": ColumnInfo("which visit of the participant"),
    "protocol": ColumnInfo("which task"),
    "block": ColumnInfo("which block of the session"),
    "trial": ColumnInfo("which trial of the block; with the stimulus, it occurs once", kind="name"),
    "repeat": ColumnInfo(
        "how many times the participant has judged it, counted from 1", kind="name"
    ),
    "stimulus_id": ColumnInfo("what was judged", kind="name", needed=True),
    "recording": ColumnInfo("as in the manifest"),
    "reducer": ColumnInfo("as in the manifest"),
    "level": ColumnInfo("as in the manifest"),
    "reference_id": ColumnInfo("what it was judged against: a stimulus, 'surface', or nothing"),
    "scale": ColumnInfo("what was asked, such as realism", kind="name", needed=True),
    "rating": ColumnInfo("the answer", "points from 0 to 100", kind="rating", needed=True),
    "response_time_s": ColumnInfo("from the end of playback to the answer", "s", kind="time"),
    "onset_s": ColumnInfo("start of playback, from the start of the session", "s", used=False),
    "underruns": ColumnInfo("interruptions of playback", "count", kind="count"),
    "rejected": ColumnInfo("whether the judgement does not count", "true or false", kind="flag"),
    "simulated": ColumnInfo("whether the participant is a program", "true or false", kind="flag"),
}
"""One row per judgement."""

MANIFEST: Mapping[str, ColumnInfo] = {
    **{name: ColumnInfo("what it is", kind="name", needed=True) for name in IDENTITY},
    "level": ColumnInfo("how its gain was chosen", kind="name"),
    "role": ColumnInfo("test, reference or anchor"),
    AMPLITUDE: ColumnInfo("root mean square as played", "m/s^2", kind="amplitude"),
    GAIN: ColumnInfo("m/s^2 played per m/s^2 recorded", kind="known"),
    SENSATION: ColumnInfo("over the detection threshold, as played", "dB", kind="known"),
    **{name: ColumnInfo(meaning, "1 = perfect match") for name, meaning in MATCHES.items()},
    **{
        name: ColumnInfo("not used", used=False)
        for name in (
            "file", "rate_hz", "n_samples", "duration_s", "peak", "clipped", "sha256", "recording_sha256",
        )
    },
    "source": ColumnInfo(
        "what the recording was made from, where several are one and the same, turned, cut or edited"
    ),
}  # fmt: skip
"""One row per stimulus."""

NOT_METRICS = frozenset({
    *IDENTITY, "level", "role", "source", "file", "sha256", "recording_sha256"
})  # fmt: skip

FURTHER: Mapping[str, tuple[str, str, tuple[str, ...]]] = {
    "rotation_mean": ("mean of the {} over random orientations of the sensor", "1 = perfect match", tuple(MATCHES)),
    "rotation_sd": ("standard deviation of the {} over random orientations of the sensor", "1", tuple(MATCHES)),
    "delivered": ("{} of the signal as it was delivered", "1 = perfect match", tuple(MATCHES)),
    "energy_weighted": ("{} with frequencies weighted by their energy", "1 = perfect match", ("spectral_match",)),
    "invariant": (
        "counterpart of the {} that no orientation changes", "1 = perfect match", ("spectral_match", "temporal_match")
    ),
}  # fmt: skip
"""Suffix of a metric's name -> meaning, unit, and the metrics that have it: per stimulus in the manifest, or per
judgement in the ratings, where a stimulus has the mean over its judgements. `spectral_match_invariant` is the former
name of `spectral_match_energy_weighted`; tables that use it are read as before."""


def describe_further() -> dict[str, ColumnInfo]:
    """List the columns of metrics that an analysis explores, beside those that it was planned for.

    Examples
    --------
    >>> list(describe_further())[:3]
    ['spectral_match_rotation_mean', 'spectral_match_rotation_sd', 'spectral_match_delivered']
    """
    return {
        f"{metric}_{kind}": ColumnInfo(
            meaning.format(metric.replace("_", " ")), unit, kind="metric"
        )
        for metric in MATCHES
        for kind, (meaning, unit, metrics) in FURTHER.items()
        if metric in metrics
    }


def describe_explored(metrics: Sequence[str]) -> dict[str, ColumnInfo]:
    """List the columns of metrics that an analysis of other metrics explores.

    Examples
    --------
    >>> list(describe_explored(["spectral_match_bounded", "temporal_match"]))[:2]
    ['spectral_match', 'spectral_match_rotation_mean']
    """
    others = {name: MANIFEST[name] for name in MATCHES} | describe_further()
    return {name: column for name, column in others.items() if name not in metrics}


def describe_ratings() -> dict[str, ColumnInfo]:
    """List the columns that a table of ratings may have."""
    return {**RATINGS, **describe_further()}


def describe_manifest(metrics: Sequence[str] = ()) -> dict[str, ColumnInfo]:
    """List the columns that a manifest may have, with the metrics that a study declares."""
    declared = {name: ColumnInfo("a metric that the study declares") for name in metrics}
    needed = {name: column for name, column in MANIFEST.items() if column.needed}
    return {**MANIFEST, **describe_further(), **declared, **needed}
