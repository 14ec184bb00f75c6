"""Choices between two stimuli: which metric predicts them, and how well anything could.

Conventions: a row is one choice, about the stimulus that was felt first (``stimulus_id``); ``other_id`` is the second
one; the rating is 100 where the first was chosen and 0 where the second was. Differences of metrics are first minus
second, turned so that a positive difference speaks for the first: a metric of which a larger value is worse is negated.
A metric is asked only about pairs of test stimuli whose reference is the recording itself or the real surface, which is
what metrics compare with; the recording itself and the anchors are far from everything and would flatter every metric.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from feel321.analysis.arrays import CONFIDENCE, Values, check_columns
from feel321.analysis.primary.model import adjust_holm
from feel321.analysis.table.items import OTHER, ROLE, STIMULUS, TEST, Table
from feel321.analysis.table.schema import CHOSEN, HIGHEST
from feel321.doors import as_names
from feel321.records import Statistic

Codes = NDArray[np.intp]


CHANCE = 0.5
FEWEST = 3  # Participants and recordings below which there is no interval
FEW = "Below 3 participants or 3 recordings there is no interval."


@dataclass(frozen=True, slots=True, eq=False)
class Votes:
    """Votes as arrays, (n_votes,): numbers of participants, sources and pairs, and whether the first was chosen.

    source: recordings, or what they were made from where several come from one. pair: the two stimuli and their
    reference, whichever came first. turned: whether the first is the second of its pair by name. differences:
    (n_votes, n_metrics).
    """

    participant: Codes
    source: Codes
    pair: Codes
    turned: NDArray[np.bool_]
    chose_first: NDArray[np.bool_]
    metrics: tuple[str, ...]
    differences: Values
    notes: tuple[str, ...] = ()

    def count(self, codes: Codes) -> int:
        """Count the participants, sources or pairs."""
        return int(codes.max(initial=-1)) + 1

    @property
    def n_units(self) -> int:
        """Participants or sources, whichever are fewer: intervals know no more than the scarcer of the two."""
        return min(self.count(self.participant), self.count(self.source))


def gather_votes(table: Table, metrics: Sequence[str] = ()) -> Votes:
    """Gather the votes of one scale; with metrics, those that the metrics are asked about."""
    import pandas as pd

    if table.stimuli is None:
        raise ValueError("table must be one of read_table, got one without stimuli")
    rows = table.rows[table.rows["scale"].isin(CHOSEN)]
    listed, names = table.stimuli, as_names(metrics, "metrics")
    if len(several := sorted(rows["scale"].unique())) > 1:
        got = f"got {', '.join(several)}; name one"
        raise ValueError(f"scale must be given where there are several, {got}")
    if rows.empty:
        raise ValueError("table must hold a choice between two stimuli or more, got none")
    notes: list[str] = []
    if names:
        check_columns(listed, names, "stimuli")
        both = [rows[name] for name in (STIMULUS, OTHER)]
        is_test = np.logical_and(*(ids.map(listed[ROLE]).to_numpy() == TEST for ids in both))
        is_known = listed[list(names)].notna().all(axis=1)
        kept = is_test & rows["matched"].to_numpy(bool)
        kept &= np.logical_and(*(ids.map(is_known).to_numpy(bool) for ids in both))
        if lost := int((is_test & ~kept).sum()):
            why = "have another reference than the recording, or a stimulus without a value of some metric"
            notes.append(f"{lost} choices {why}: no metric is tested on them.")
        if not kept.any():
            raise ValueError(notes[0] if notes else "No choice is between two test stimuli.")
        rows = rows[kept]
    one, other = (rows[name].astype(str).to_numpy() for name in (STIMULUS, OTHER))
    known, codes = np.unique(np.concatenate([one, other]), return_inverse=True)
    first, second = np.split(codes.astype(np.intp), 2)
    reference = rows["reference_id"].fillna("").to_numpy()
    ends = [np.minimum(first, second), np.maximum(first, second), reference]
    worse = [name in table.info and table.info[name].higher == "worse" for name in names]
    values = listed.loc[known, list(names)].to_numpy(np.float64) * np.where(worse, -1.0, 1.0)
    return Votes(
        participant=pd.factorize(rows["participant"])[0], source=pd.factorize(rows[STIMULUS].map(listed["source"]))[0],
        pair=pd.factorize(pd.MultiIndex.from_arrays(ends))[0], turned=first > second,
        chose_first=(rows["rating"] == HIGHEST).to_numpy(), metrics=names,
        differences=values[first] - values[second], notes=tuple(notes),
    )  # fmt: skip


def predict(votes: Votes) -> Statistic:
    """Count how many votes each metric predicts: the one for the stimulus with its better value.

    ``shares``, indexed by metric: ``share`` of votes predicted, a tie counting half, its 95 % two-way interval ``low
    high``, ``p`` against chance (0.5), ``p_holm`` and ``n_ties``; ``differences`` of two metrics' shares, likewise;
    ``others others_low others_high``, the share that the majority of the other participants made of the same pair, and
    ``majority``, that of all: the ceiling from both sides (Nili et al. 2014, doi 10.1371/journal.pcbi.1003553).

    Intervals hold for other people and other recordings: the variance is that of clustering by participants and by
    recordings (Cameron, Gelbach & Miller 2011, doi 10.1198/jbes.2010.07136), V_P + V_R - V_PR, each part multiplied by
    G / (G - 1) for G groups, and never less than V_P or V_R; 95 % t intervals with U - 1 degrees of freedom, U the
    smaller number of the two, of shares on the scale of log odds. Below 3 participants or recordings there is none.
    A bootstrap of both counts the noise of choices three times: in 300 simulated studies of a metric without effect it
    found one in 0 to 2 %, this variance in 1 to 5 % (nominal 5 %).
    """
    import pandas as pd

    # 1 predicted, 0 not, 0.5 where the metric of the two is the same.
    hits = (1 + np.sign(votes.differences) * np.where(votes.chose_first, 1.0, -1.0)[:, None]) / 2
    others, majority = agree_with_others(votes)
    names = pd.Index(votes.metrics, name="metric")
    shares = pd.DataFrame([infer_share(votes, column) for column in hits.T], index=names)
    shares = shares.assign(n_ties=(hits == CHANCE).sum(axis=0))
    told = []
    for one, two in combinations(range(len(names)), 2):
        each = hits[:, one] - hits[:, two]
        value = float(each.mean())
        margin, p = _judge(value, _measure_error(votes, (each - value) / len(each)), votes.n_units)
        ends = {"difference": value, "low": value - margin, "high": value + margin, "p": p}
        told.append({"first": names[one], "second": names[two], **ends})
    differences = pd.DataFrame(told, columns=["first", "second", "difference", "low", "high", "p"])
    notes, is_known = list(votes.notes), np.isfinite(others).mean() >= CHANCE
    if votes.n_units < FEWEST:
        notes.append(FEW)
    if not is_known:
        few = "Fewer than half of the choices were also made by somebody else"
        notes.append(f"{few}: how well people agree cannot be estimated.")
    alike = infer_share(votes, others if is_known else np.full(len(votes.pair), np.nan))
    return Statistic(
        "VotePrediction",
        shares=shares.assign(p_holm=adjust_holm(shares["p"].tolist())),
        differences=differences.assign(p_holm=adjust_holm(differences["p"].tolist())),
        others=alike["share"], others_low=alike["low"], others_high=alike["high"],
        majority=float(majority.mean()) if is_known else np.nan,
        n_votes=len(votes.pair), n_participants=votes.count(votes.participant), n_recordings=votes.count(votes.source),
        n_pairs=votes.count(votes.pair), notes=tuple(notes),
    )  # fmt: skip


def agree_with_others(votes: Votes) -> tuple[Values, Values]:
    """Score every vote by the majority on its pair, of the other participants (NaN for none), and of all; draws 0.5."""
    # Votes for the stimulus of each pair that is first by name.
    voted = votes.chose_first != votes.turned
    for_low, cast = np.bincount(votes.pair, voted)[votes.pair], np.bincount(votes.pair)[votes.pair]
    both = np.stack([votes.pair, votes.participant])
    own = np.unique(both, axis=1, return_inverse=True)[1].ravel()
    rest, n_rest = for_low - np.bincount(own, voted)[own], cast - np.bincount(own)[own]
    side = np.where(voted, 1, -1)
    others = np.where(n_rest > 0, (1 + np.sign(2 * rest - n_rest) * side) / 2, np.nan)
    return others, (1 + np.sign(2 * for_low - cast) * side) / 2


def infer_share(votes: Votes, scores: Values) -> dict[str, float]:
    """Give the mean of scores, (n_votes,), its interval on the scale of log odds, and p; NaN scores are left out."""
    from scipy.special import expit, logit

    known = np.isfinite(scores)
    share = float(scores[known].mean()) if known.any() else np.nan
    if not 0 < share < 1:
        return {"share": share, "low": np.nan, "high": np.nan, "p": np.nan}
    influence = np.where(known, scores - share, 0.0) / known.sum()
    error = _measure_error(votes, influence) / (share * (1 - share))
    centre = float(logit(share))
    margin, p = _judge(centre, error, votes.n_units)
    low, high = float(expit(centre - margin)), float(expit(centre + margin))
    return {"share": share, "low": low, "high": high, "p": p}


def _measure_error(votes: Votes, influence: Values) -> float:
    """Measure the standard error of a mean from the influence of each vote, (n_votes,), by two-way clustering."""
    cells, parts = votes.participant * votes.count(votes.source) + votes.source, []
    for groups in (votes.participant, votes.source, cells):
        sums = np.bincount(np.unique(groups, return_inverse=True)[1], influence)
        # G / (G - 1) for G groups
        parts.append(float(sums @ sums) * len(sums) / max(len(sums) - 1, 1))
    one, other, both = parts
    error = float(np.sqrt(max(one + other - both, one, other)))
    return error if votes.n_units >= FEWEST and error > 0 else float("nan")


def _judge(value: float, error: float, units: int) -> tuple[float, float]:
    """Compute the margin of the 95 % interval, and the two-sided p."""
    from scipy.stats import t

    if not np.isfinite(error):
        return np.nan, np.nan
    margin = float(t.ppf((1 + CONFIDENCE) / 2, units - 1)) * error
    return margin, float(2 * t.sf(abs(value) / error, units - 1))
