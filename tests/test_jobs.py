"""Jobs: the same results, in the same order, whoever does them."""

from __future__ import annotations

import operator
from itertools import count

import pytest

from feel321.analysis.tradeoff.advise.page import advise_recordings
from feel321.analysis.tradeoff.advise.scene import Context
from feel321.analysis.tradeoff.chart.compute import Effort, list_accuracy_jobs
from feel321.analysis.tradeoff.stress.measures import measure_scene
from feel321.jobs import Job, Workers, gather_results, run_jobs
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.synthesis import make_scene

FEW = {name: REDUCERS[name] for name in ("sax321", "dft321", "pca321")}


def test_two_processes_give_what_one_gives() -> None:
    scene = make_scene("bumps", duration_s=0.3)
    little = Effort("little", 0.1, 2, 2, 100, 3)
    jobs: list[Job] = [
        (measure_scene, (name, FEW), {"takes": 2, "seed": 1}) for name in ("circular", "one_axis")
    ]
    jobs.append(next(list_accuracy_jobs([scene], little, {}, seed=1)))
    jobs.append((advise_recordings, (scene, Context()), {"seed": 1}))
    steps = count(1)
    one, two = (
        gather_results(jobs),
        gather_results(jobs, workers=Workers(2), done=lambda: next(steps)),
    )
    assert repr(one[:-1]) == repr(two[:-1])
    assert one[-1].summary() == two[-1].summary()
    assert next(steps) == len(jobs) + 1


def test_jobs_are_taken_only_a_few_ahead() -> None:
    taken = count()
    jobs = ((operator.add, (next(taken), 1), {}) for _ in range(1000))
    place, result = next(run_jobs(jobs))
    assert result == place + 1
    assert next(taken) <= 3


@pytest.mark.parametrize(
    "address", ["127.0.0.1:8786", "tcp://host", "http://host:1", "tcp://:port"]
)
def test_an_address_that_is_none_is_refused(address: str) -> None:
    with pytest.raises(ValueError, match=r"^scheduler must be tcp://HOST:PORT or tls://.*got "):
        Workers(1, address)


def test_a_cluster_needs_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("feel321.jobs.find_spec", lambda _: None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'feel321\[cluster\]'"):
        [*run_jobs([], workers=Workers(1, "tcp://127.0.0.1:1"))]
