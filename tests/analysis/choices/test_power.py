"""Power for choices: the planted shares are reached, an equal pair is found at 5 %, and more of everything helps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest

from feel321 import analysis

if TYPE_CHECKING:
    from collections.abc import Callable

METRICS = ["spectral_match_bounded", "temporal_match"]


def list_stimuli(n_recordings: int = 8, seed: int = 0) -> pd.DataFrame:
    values = np.random.default_rng(seed).random((6 * n_recordings, 2))
    return pd.DataFrame(values, columns=METRICS).assign(
        stimulus_id=[f"s{number}" for number in range(len(values))],
        recording=np.repeat(np.arange(n_recordings), 6),
    )


def test_the_planted_shares_are_those_that_are_then_predicted() -> None:
    power = analysis.plan_choices(
        list_stimuli(), METRICS, shares=(0.68, 0.56), participants=[30], runs=60, rng=2
    )
    (row,) = power.table.to_dict("records")
    assert row["difference"] == pytest.approx(0.12, abs=0.03)
    assert row["votes"] == 30 * 8 * 15
    assert power.weights[0] > power.weights[1] > 0


def test_more_participants_pairs_and_recordings_give_more_power() -> None:
    def find(n_recordings: int, **sizes: Any) -> pd.Series:
        stimuli = list_stimuli(n_recordings)
        found = analysis.plan_choices(
            stimuli, METRICS, shares=(0.66, 0.57), runs=100, rng=4, **sizes
        )
        return found.table["power"]

    people = find(8, participants=[4, 24])
    assert people.iloc[1] > people.iloc[0] + 0.1
    pairs = find(8, participants=[10], pairs=[2, None])
    assert pairs.iloc[1] > pairs.iloc[0] + 0.1
    assert find(24, participants=[10]).iloc[0] > find(6, participants=[10]).iloc[0] + 0.1


def test_metrics_that_predict_alike_differ_seldom() -> None:
    """Nominal 5 %; measured: 2 to 4 %."""
    power = analysis.plan_choices(
        list_stimuli(), METRICS, shares=(0.62, 0.62), participants=[12], runs=200, rng=1
    )
    assert power.table["power"].iloc[0] <= 0.1
    assert power.table["low"].iloc[0] <= power.table["power"].iloc[0] <= power.table["high"].iloc[0]


def test_the_direction_of_a_metric_counts() -> None:
    stimuli = list_stimuli()
    turned = stimuli.assign(**{METRICS[1]: -stimuli[METRICS[1]]})
    one = analysis.plan_choices(stimuli, METRICS, shares=(0.66, 0.57), participants=[6], runs=5)
    other = analysis.plan_choices(
        turned, METRICS, shares=(0.66, 0.57), participants=[6], runs=5, higher={METRICS[1]: "worse"}
    )
    assert one.table.equals(other.table)


def test_a_participant_judges_each_asked_pair_once(monkeypatch: pytest.MonkeyPatch) -> None:
    from feel321.analysis.choices import power as module

    seen: list[Any] = []
    real: Callable[..., Any] = module.score_metrics
    monkeypatch.setattr(module, "score_metrics", lambda votes: seen.append(votes) or real(votes))
    analysis.plan_choices(
        list_stimuli(), METRICS, shares=(0.66, 0.57), participants=[5], pairs=[4], runs=2
    )
    for votes in seen:
        asked = pd.DataFrame({"who": votes.participant, "scene": votes.source, "pair": votes.pair})
        assert not asked.duplicated().any()
        assert set(asked.groupby(["who", "scene"]).size()) == {4}
        assert len(asked.groupby(["who", "scene"])) == 5 * 8


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"metrics": ["temporal_match"]}, "metrics must be two names"),
        ({"shares": (0.4, 0.6)}, "shares must be two numbers from 0.5"),
        ({"shares": (0.99, 0.5)}, "shares must be possible with these stimuli, got 0.99 and 0.5"),
        ({"lapse": 0.6}, "lapse must be from 0 to less than 0.5, got 0.6"),
        ({"runs": 1}, "runs must be 2 or more, got 1"),
    ],
)
def test_what_cannot_be_planned_is_refused(changes: dict[str, Any], message: str) -> None:
    given = {"metrics": METRICS, "shares": (0.66, 0.57), "runs": 3, **changes}
    with pytest.raises(ValueError, match=message):
        analysis.plan_choices(list_stimuli(), **given)
