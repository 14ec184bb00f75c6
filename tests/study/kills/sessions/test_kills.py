"""Sudden death: SIGKILL between and inside the records of every protocol, and again while going on.

Every protocol dies once in each way; the soak tests go through all instants, presenters and ways.

`k` counts the calls that leave a trace on the disk (or, with `j`, the records); an instant is a share of a session.
"""

from collections.abc import Callable, Iterable
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from feel321.study.session.journal import read_journal

TASKS = (
    "realism",
    "similarity-strict",
    "similarity-replay",
    "dissimilarity",
    "mushra",
    "abx",
    "triplet",
    "preference",
)
PRESENTERS = ("observer", "scripted")
OPENING = 60
"""So many calls at most until a session is open: the number, the plan, the journal or its mending."""

every_session = pytest.mark.parametrize(
    ("task", "presenter"), [(task, presenter) for task in TASKS for presenter in PRESENTERS]
)


def vary(
    names: str, rows: Iterable[tuple[Any, ...]], *, every: Callable[..., bool]
) -> pytest.MarkDecorator:
    """Parametrize with all rows; those that `every` does not pick wait for `make soak`."""
    return pytest.mark.parametrize(
        names.split(),
        [pytest.param(*row, marks=[] if every(*row) else [pytest.mark.soak]) for row in rows],
    )


@vary(
    "task presenter instant",
    product(TASKS, PRESENTERS, (0.3, 0.8)),
    every=lambda task, presenter, instant: (
        (presenter, instant) == (("scripted", 0.3), ("observer", 0.8))[TASKS.index(task) % 2]
    ),
)
def test_between_two_calls(
    lab: Any, task: str, presenter: str, instant: float, tmp_path: Path
) -> None:
    lab.endure(
        task, presenter, [lab.place(instant, task=task, presenter=presenter)], tmp_path / "killed"
    )


@vary(
    "task presenter j",
    [(task, *end) for task in TASKS for end in [("observer", 0.5), ("scripted", 1.0)]],
    every=lambda task, presenter, _: presenter == PRESENTERS[TASKS.index(task) % 2],
)
def test_inside_a_record(lab: Any, task: str, presenter: str, j: float, tmp_path: Path) -> None:
    lab.endure(
        task, presenter, [lab.place(0.6, task=task, presenter=presenter, j=j)], tmp_path / "killed"
    )


@pytest.mark.parametrize("instant", [0.96, 0.98])
def test_after_the_last_record(lab: Any, instant: float, tmp_path: Path) -> None:
    lab.endure(
        "abx",
        "observer",
        [lab.place(instant, task="abx", presenter="observer")],
        tmp_path / "killed",
    )


@vary("k", [(k,) for k in (6, 15, 26, *range(35, 54, 4))], every=lambda k: k in {15, 39, 51})
def test_before_the_first_record(lab: Any, k: int, tmp_path: Path) -> None:
    lab.endure("similarity-replay", "scripted", [lab.at(k)], tmp_path / "killed")


@vary("k", [(k,) for k in range(29, 49, 4)], every=lambda k: k in {33, 45})
def test_again_while_a_torn_line_is_mended(lab: Any, k: int, tmp_path: Path) -> None:
    torn = lab.place(0.6, task="dissimilarity", presenter="observer", j=0.5)
    lab.endure("dissimilarity", "observer", [torn, lab.at(k), lab.at(k + 1)], tmp_path / "killed")


@vary(
    "policy k torn",
    [
        (policy, *when)
        for policy in ("warm_up", "restart")
        for when in [*((k, None) for k in (29, 32, 35, 38, 41, 53)), (39, 0.5), (42, 0.5)]
    ],
    every=lambda _, k, __: k in {35, 42},
)
def test_again_the_next_day(
    lab: Any, k: int, torn: float | None, policy: str, tmp_path: Path
) -> None:
    first = lab.place(0.6, task="abx", presenter="observer", j=torn)
    assert_one_day(
        lab.endure("abx", "observer", [first, lab.at(k)], tmp_path / "killed", policy=policy),
        policy,
    )


@vary(
    "presenter instant torn",
    product(PRESENTERS, [n / 24 for n in range(24)], (None, 0.5)),
    every=lambda presenter, instant, torn: (presenter, instant, torn) == ("scripted", 0.25, 0.5),
)
def test_in_the_blocks_before_the_trials(
    lab: Any, presenter: str, instant: float, torn: float | None, tmp_path: Path
) -> None:
    """Thresholds, then matched strength: after two kills, the levels are those of a session that never died."""
    first = lab.place(instant, task="blocks", presenter=presenter, j=torn)
    lab.endure("blocks", presenter, [first, lab.at(OPENING)], tmp_path / "killed")


def assert_one_day(study: Any, policy: str) -> None:
    events = [record.event for path in study.journals for record in read_journal(path).records]
    # The day after is one day, however often one dies on it.
    assert events.count({"warm_up": "warm_up", "restart": "superseded"}[policy]) == 1
    assert len(study.journals) == {"warm_up": 1, "restart": 2}[policy]


@vary(
    "task instant",
    product(TASKS, (0.2, 0.6)),
    every=lambda task, instant: instant == (0.2, 0.6)[TASKS.index(task) % 2],
)
def test_from_outside(lab: Any, task: str, instant: float, tmp_path: Path) -> None:
    lab.endure(task, "scripted", [instant], tmp_path / "killed")


@pytest.mark.soak
class TestSoak:
    """The same, so often that no instant is left out by luck."""

    @pytest.mark.parametrize("instant", [n / 40 for n in range(40)])
    @every_session
    def test_between_two_calls(
        self, lab: Any, task: str, presenter: str, instant: float, tmp_path: Path
    ) -> None:
        lab.endure(
            task,
            presenter,
            [lab.place(instant, task=task, presenter=presenter)],
            tmp_path / "killed",
        )

    @pytest.mark.parametrize("j", [0.0, 0.3, 1.0])
    @pytest.mark.parametrize("instant", [n / 8 for n in range(8)])
    @every_session
    def test_inside_a_record(
        self, lab: Any, task: str, presenter: str, instant: float, j: float, tmp_path: Path
    ) -> None:
        lab.endure(
            task,
            presenter,
            [lab.place(instant, task=task, presenter=presenter, j=j)],
            tmp_path / "killed",
        )

    @pytest.mark.parametrize("k", range(1, OPENING))
    @pytest.mark.parametrize("presenter", PRESENTERS)
    def test_every_call_of_the_first_opening(
        self, lab: Any, presenter: str, k: int, tmp_path: Path
    ) -> None:
        lab.endure("realism", presenter, [lab.at(k)], tmp_path / "killed")

    @pytest.mark.parametrize("k", range(1, OPENING))
    @pytest.mark.parametrize("presenter", PRESENTERS)
    def test_every_call_of_mending(self, lab: Any, presenter: str, k: int, tmp_path: Path) -> None:
        torn = lab.place(0.6, task="mushra", presenter=presenter, j=0.5)
        lab.endure("mushra", presenter, [torn, lab.at(k), lab.at(k + 1)], tmp_path / "killed")

    @pytest.mark.parametrize("policy", ["warm_up", "restart"])
    @pytest.mark.parametrize("k", range(1, OPENING))
    @pytest.mark.parametrize("torn", [None, 0.5])
    def test_every_call_of_the_next_day(
        self, lab: Any, k: int, torn: float | None, policy: str, tmp_path: Path
    ) -> None:
        first = lab.place(0.6, task="abx", presenter="observer", j=torn)
        assert_one_day(
            lab.endure("abx", "observer", [first, lab.at(k)], tmp_path / "killed", policy=policy),
            policy,
        )

    @pytest.mark.parametrize("seed", range(5))
    @every_session
    def test_from_outside(
        self, lab: Any, task: str, presenter: str, seed: int, tmp_path: Path
    ) -> None:
        instants = sorted(lab.draw(seed, 3))
        lab.endure(task, presenter, instants, tmp_path / "killed")
