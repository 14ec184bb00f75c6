"""What chart, stress and advise take and refuse, from Python."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest

from feel321 import analysis
from feel321.analysis.table.items import Table
from feel321.analysis.tradeoff.chart import compute
from feel321.analysis.tradeoff.results import as_recordings, as_table
from feel321.stimuli.recording import Recording
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.synthesis import make_scene

if TYPE_CHECKING:
    from collections.abc import Callable

BUMPS = make_scene("bumps", duration_s=0.3)
FEW: dict[str, Any] = {"reducers": ["mag321", "pca321"], "takes": 2, "draws": 2}
VERBS: dict[str, Callable[..., object]] = {
    "chart": analysis.chart,
    "stress": lambda recordings: analysis.stress(recordings, **FEW),
    "advise": analysis.advise,
}


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("bumps.wav", "must be Recordings, got 'bumps.wav'; make one with stimuli.read_recording"),
        (None, "must be Recordings, got None"),
        ([np.zeros((3, 9))], r"must be Recordings, got ndarray of shape \(3, 9\)"),
        ([BUMPS, BUMPS], "must have different names, got 'bumps' twice"),
    ],
)
def test_what_is_no_recording_is_refused(verb: str, given: object, message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        VERBS[verb](given)


def test_one_recording_is_a_list_of_one(monkeypatch: pytest.MonkeyPatch) -> None:
    assert as_recordings(BUMPS) == as_recordings(iter([BUMPS])) == (BUMPS,)
    assert analysis.advise(BUMPS) == analysis.advise([BUMPS])
    assert analysis.stress(BUMPS, **FEW) == analysis.stress([BUMPS], **FEW)
    taken: list[object] = []
    monkeypatch.setattr(compute, "_measure", lambda given, *_, **__: taken.append(given) or {})
    with pytest.raises(KeyError):
        analysis.chart(BUMPS)
    assert taken == [(BUMPS,)]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"latency_ms": 5}, "latency_ms must be left out offline, .* got 5; set online=True"),
        ({"weber": 22}, "^weber must be above 0 and below 1, got 22"),
        ({"segment_s": 0.01}, "^segment_s must be 0.1 s or more, got 0.01"),
        ({"mounting": "some"}, "^mounting must be any or recorded, got 'some'"),
        ({"axes": 1.5}, "^axes must be 1, 2 or 3, got 1.5"),
    ],
)
def test_advise_speaks_of_its_own_arguments(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        analysis.advise(BUMPS, **options)


@pytest.mark.parametrize("margin", [0, -5.0, float("nan"), float("inf")])
def test_a_margin_must_be_one(margin: float) -> None:
    with pytest.raises(ValueError, match="margin must be a number of points above 0, got"):
        analysis.advise(BUMPS, ratings=rate(), margin=margin)


def rate() -> pd.DataFrame:
    """Twelve people rate two reducers of one recording twice; one judgement was rejected."""
    rng = np.random.default_rng(0)
    rows = [
        (f"P{person}", "bumps", reducer, "realism", "as_is", mean + rng.normal(0, 3), False)
        for person in range(12)
        for reducer, mean in (("pca321", 40), ("dft321_principal", 80))
        for _ in range(2)
    ]
    rows.append(("P0", "bumps", "pca321", "realism", "as_is", 100, True))
    names = ["participant", "recording", "reducer", "scale", "level", "rating", "rejected"]
    return pd.DataFrame(rows, columns=names)


def test_ratings_may_be_a_data_frame() -> None:
    frame = rate()
    table = as_table(frame)
    assert as_table(table) is table
    assert len(table.rows) == len(frame) - 1
    assert set(table.rows["role"]) == {"test"}
    assert not table.rows["simulated"].any()
    advice = analysis.advise(BUMPS, ratings=frame, margin=5.0)
    assert advice == analysis.advise(BUMPS, ratings=table, margin=5.0)
    assert not analysis.advise(BUMPS, ratings=table).rated
    assert advice.rated == ("bumps",)
    means = {row["reducer"]: row["mean"] for row in compute.rate_reducers(table.rows, seed=0)}
    assert means == pytest.approx({"pca321": 40, "dft321_principal": 80}, abs=2)


def test_ratings_without_a_column_are_refused() -> None:
    for ratings, message in (
        (rate().drop(columns="level"), "column level is missing"),
        ([1, 2], "ratings must be a Table or a pandas DataFrame"),
    ):
        with pytest.raises((TypeError, ValueError), match=message):
            analysis.advise(BUMPS, ratings=ratings)
        with pytest.raises((TypeError, ValueError), match=message):
            analysis.chart(BUMPS, ratings=ratings)
    assert isinstance(as_table(rate()), Table)


def half_diagonal(acceleration: np.ndarray, _: float) -> np.ndarray:
    """A lab's own reducer, for one signal at a time."""
    x, y, _z = acceleration
    return 0.5 * (x + y)


def test_stress_takes_a_labs_own_reducers_in_every_form(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = {"takes": 2, "draws": 2}
    alone = analysis.stress(BUMPS, reducers=[half_diagonal], **few)
    assert alone.reducers == ("half_diagonal",)
    batched = {"half_diagonal": lambda a, _: 0.5 * (a[..., 0, :] + a[..., 1, :])}
    assert analysis.stress(BUMPS, reducers=batched, **few) == alone
    (tmp_path / "mylab_stress.py").write_text(
        "from feel321.stimuli.reducers.axes import mag321\n"
        "def length(acceleration, rate_hz):\n    return mag321(acceleration, rate_hz)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    mixed = analysis.stress(reducers=["mag321", "mylab_stress:length"], **few)
    assert mixed.reducers == ("mag321", "length")
    first, second = (
        [replace(one, reducer="") for one in mixed.cells if one.reducer == name]
        for name in mixed.reducers
    )
    np.testing.assert_equal([one.value for one in first], [one.value for one in second])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"reducers": {"mine": lambda a, _: a}},
            r"must return the shape \(4000,\), got \(3, 4000\)",
        ),
        ({"takes": 2.5}, "takes must be a whole number of 2 or more, got 2.5"),
        ({"sensor": [BUMPS]}, "sensor must be a mapping of names to Recordings, got "),
        ({"sensor": {"bump": BUMPS}}, r"sensor must name recordings \(bumps\), got 'bump'"),
    ],
)
def test_stress_refuses(options: dict[str, Any], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        analysis.stress(BUMPS, **{**FEW, **options})


def test_an_advice_on_one_scene_does_not_speak_of_all() -> None:
    calm = Recording(np.zeros((3, 4000)), 4000.0, "calm")
    one = analysis.advise([BUMPS, calm])
    assert one.headline.endswith(" suffices for the one scene with vibration; 1 of 2 is silent.")
    one = replace(one, advices=(one.advices[0], *2 * one.advices[1:]))
    assert one.headline.endswith(" the one scene with vibration; 2 of 3 are silent.")
    advised = {one.name for one in analysis.advise(BUMPS).advices[0].verdicts}
    assert advised == {*REDUCERS}
