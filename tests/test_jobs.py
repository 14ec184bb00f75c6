"""Jobs: the same results, in the same order, whoever does them."""

from __future__ import annotations

import operator
from itertools import count

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
