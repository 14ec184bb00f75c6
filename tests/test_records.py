"""Records, arguments and jobs, which everything else is built on."""

import copy
import operator
import pickle
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
import pandas as pd
import pytest

from feel321.arguments import Registry, as_names, as_path, as_rng, as_seed
from feel321.jobs import Job, Workers, gather_results, run_jobs
from feel321.records import REPR_WIDTH, Result


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Fit(Result):
    name: str
    slope: float
    votes: np.ndarray
    table: pd.DataFrame
    parts: "tuple[Fit, ...]" = ()


def make(**changes: object) -> Fit:
    frame = pd.DataFrame({"a": [1.0, np.nan], "b": ["x", "y"]}, index=pd.Index([3, 4], name="item"))
    part = Fit("part", np.nan, np.array([1.0, np.nan]), frame)
    return replace(Fit("all", 0.5, np.arange(3.0), frame, (part,)), **changes)


def test_dictionary_is_what_json_holds() -> None:
    found = make().to_dict()

    rows = [{"item": 3, "a": 1.0, "b": "x"}, {"item": 4, "a": None, "b": "y"}]
    part = {"name": "part", "slope": None, "votes": [1.0, None], "table": rows, "parts": []}
    whole = {"name": "all", "slope": 0.5, "votes": [0.0, 1.0, 2.0], "table": rows, "parts": [part]}
    assert found == whole


def test_frame_summary_and_html_show_numbers_and_names() -> None:
    assert make().to_frame().to_dict("records") == [{"name": "all", "slope": 0.5}]
    assert make().summary().splitlines()[0] == "Fit"
    assert "0.5" in make().summary()
    shown = make(name="<b>")._repr_html_()
    assert "<caption>Fit</caption>" in shown
    assert '<th scope="row">slope</th>' in shown
    assert "&lt;b&gt;" in shown
    assert "<b>" not in shown


def test_repr_is_one_short_line() -> None:
    assert repr(make()) == "Fit(name='all', slope=0.5)"
    assert len(repr(make(name="x" * 1000))) <= REPR_WIDTH


def test_equality_and_pickle_know_arrays_tables_and_undefined_numbers() -> None:
    assert make() == make() == pickle.loads(pickle.dumps(make()))  # noqa: S301 - our own bytes
    assert hash(make()) == hash(make())
    assert make() != make(votes=np.array([0.0, 1.0, 3.0]))
    assert make() != make(table=make().table.assign(a=2.0))
    assert make() != make(parts=())


def test_doors_refuse_in_one_line() -> None:
    with pytest.raises(TypeError, match=r"^path must be a path, got 3$"):
        as_path(3)
    with pytest.raises(TypeError, match=r"^rng must be a whole number from 0 or .* got -1$"):
        as_rng(-1)
    with pytest.raises(TypeError, match=r"^reducers must be a list of names, got the text 'df"):
        as_names("dft321", "reducers")


def test_a_registry_survives_pickling_and_copying() -> None:
    registry = Registry("thing", {"one": len, "two": max})
    for again in (pickle.loads(pickle.dumps(registry)), copy.deepcopy(registry)):  # noqa: S301 - our own bytes
        assert dict(again) == {"one": len, "two": max}
        assert again["two"] is max
    assert repr(registry) == "<thing: one, two>"


def test_several_entries_are_chosen_by_name_or_as_they_are() -> None:
    registry = Registry("thing", {"one": len, "two": max})
    assert registry.choose() == {"one": len, "two": max}
    assert registry.choose(["two", abs]) == {"two": max, "abs": abs}
    with pytest.raises(ValueError, match="thing must be one of one, two; got 'three'"):
        registry.find("three")
    with pytest.raises(TypeError, match=r"things.*write \['one'\]"):
        registry.choose("one")


def test_a_seed_is_taken_or_drawn() -> None:
    assert as_seed(7) == 7
    assert as_seed(np.random.default_rng(1)) == as_seed(np.random.default_rng(1)) >= 0
    with pytest.raises(TypeError, match="rng must be a whole number from 0"):
        as_seed(-1)


# Jobs: the same results, in the same order, whoever does them.


def test_two_processes_give_what_one_gives() -> None:
    jobs: list[Job] = [(pow, (base, 3), {"mod": 7}) for base in range(20)]
    steps = count(1)
    two = gather_results(jobs, workers=Workers(2), done=lambda: next(steps))
    assert two == gather_results(jobs) == [base**3 % 7 for base in range(20)]
    assert next(steps) == len(jobs) + 1


def test_jobs_are_taken_only_a_few_ahead() -> None:
    taken = count()
    jobs = ((operator.add, (next(taken), 1), {}) for _ in range(1000))
    place, result = next(run_jobs(jobs))
    assert result == place + 1
    assert next(taken) <= 3
