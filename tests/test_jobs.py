"""Jobs: the same results, in the same order, whoever does them."""

from __future__ import annotations

import operator
from itertools import count

import pytest

from feel321.analysis.tradeoff.cost import list_candidates
from feel321.analysis.tradeoff.measure import QUICK, Scope, measure_recording
from feel321.jobs import Job, Workers, gather_results, run_jobs
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.synthesis import make_scene

FEW = {name: REDUCERS[name] for name in ("sax321", "dft321", "pca321")}


def test_two_processes_give_what_one_gives() -> None:
    trial = Scope(list_candidates(FEW), {}, QUICK, 1)
    scenes = [make_scene(name, duration_s=0.3) for name in ("bumps", "hard_taps", "texture_drag")]
    jobs: list[Job] = [(measure_recording, (scene, trial), {}) for scene in scenes]
    steps = count(1)
    one, two = (
        gather_results(jobs),
        gather_results(jobs, workers=Workers(2), done=lambda: next(steps)),
    )
    assert repr(one) == repr(two)
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
