"""What ratings say of the reducers, and that they are heard only with a margin."""

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.tradeoff.judge import compare_rated
from feel321.analysis.tradeoff.page import advise_tradeoff
from tests.analysis.tradeoff.made import make_frame

MEANS = {"best": 80.0, "alike": 79.5, "unsure": 75.0, "worse": 50.0}


def rate(people: int = 12, *, recording: str = "made") -> pd.DataFrame:
    rng = np.random.default_rng(0)
    rows = [
        (f"P{person}", recording, name, "realism", "as_is", mean + rng.normal(0, 4), False)
        for person in range(people)
        for name, mean in MEANS.items()
        for _ in range(2)
    ]
    rows.append(("P0", recording, "worse", "realism", "as_is", 100, True))
    names = ["participant", "recording", "reducer", "scale", "level", "rating", "rejected"]
    return pd.DataFrame(rows, columns=names)


def test_equivalent_open_and_worse() -> None:
    found = compare_rated(rate(), margin=5.0)
    said = dict(zip(found["reducer"], found["agree"], strict=True))
    assert said == {"best": "best", "alike": "equivalent", "unsure": "open", "worse": "worse"}
    gaps = found.set_index("reducer")["difference"]
    assert gaps.to_dict() == pytest.approx(
        {"best": 0, "alike": 0, "unsure": -5, "worse": -30}, abs=2
    )


def test_without_margin_or_ratings_nobody_is_heard() -> None:
    assert not len(compare_rated(rate()))
    assert not len(compare_rated(None, margin=5.0))


def test_who_is_rated_worse_is_not_advised_and_the_others_are_reported() -> None:
    frame = make_frame({"worse": {}, "unsure": {}, "best": {}})
    assert list(advise_tradeoff(frame).choices["answer"]) == ["worse"]
    heard = advise_tradeoff(frame, ratings=rate(), margin=5.0)
    assert heard.choices[["answer", "people"]].to_numpy().tolist() == [["unsure", "open"]]
    assert "worse would suffice, but people rate it lower" in heard.summary()
    assert "ratings do not show whether people agree" in heard.summary()
    other = advise_tradeoff(frame, ratings=rate(recording="elsewhere"), margin=5.0)
    assert other.choices[["answer", "people"]].to_numpy().tolist() == [["worse", ""]]
