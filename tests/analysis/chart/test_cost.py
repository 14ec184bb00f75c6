from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pytest

from feel321.analysis.tradeoff.chart.accuracy import ReducerVariant
from feel321.analysis.tradeoff.chart.compute import describe_machine
from feel321.analysis.tradeoff.chart.cost import (
    BLOCKS_PER_ROUND,
    REFERENCE_N,
    WARM_UP,
    Job,
    choose_clock,
    compare_precision,
    fit_all,
    list_lengths,
    list_resources,
    measure_memory,
    time_blocks,
    time_in_turn,
    time_jobs,
)
from feel321.analysis.tradeoff.chart.points import make_table
from feel321.stimuli.reducers.registry import REDUCERS

if TYPE_CHECKING:
    from pathlib import Path


class Machine:
    """Work that moves its own clock, so that time is known."""

    def __init__(self) -> None:
        self.now = 0.0
        self.done: list[str] = []

    def work(self, name: str, seconds: float) -> None:
        self.done.append(name)
        self.now += seconds

    def clock(self) -> float:
        return self.now


def make_job(machine: Machine, n: int, seconds: float, name: str = "soc321") -> Job:
    return Job(
        "size",
        ReducerVariant(name),
        n,
        10_000.0,
        n,
        64,
        partial(machine.work, f"{name} {n}", seconds),
    )


def test_every_round_times_every_task_once_in_another_order() -> None:
    machine = Machine()
    tasks = [partial(machine.work, str(k), k + 1.0) for k in range(6)]
    rounds: list[int] = []
    seconds = time_in_turn(
        tasks,
        rounds=4,
        clock=machine.clock,
        rng=np.random.default_rng(0),
        done=lambda: rounds.append(1),
    )
    assert np.array_equal(seconds, np.tile(np.arange(1.0, 7.0), (4, 1)))
    orders = [machine.done[start : start + 6] for start in range(0, 30, 6)]
    assert all(sorted(order) == list("012345") for order in orders)
    assert len(set(map(tuple, orders))) > 1
    assert len(rounds) == 5


def test_times_become_costs_with_quartiles() -> None:
    # The first round is not measured.
    machine, left = (Machine(), iter([9.0, 1.0, 2.0, 3.0, 4.0, 5.0]))
    job = Job(
        "size",
        ReducerVariant("soc321"),
        1000,
        500.0,
        1000,
        64,
        lambda: machine.work("", next(left)),
    )
    (cost,) = time_jobs([job], rounds=5, clock=machine.clock, rng=np.random.default_rng(0))
    assert (cost["ns_per_sample"], cost["low"], cost["high"]) == pytest.approx((3e6, 2e6, 4e6))
    assert cost["real_time"] == pytest.approx(2.0 / 3.0)
    assert (cost["rounds"], cost["method"]) == (5, "soc321")


@pytest.mark.parametrize("exponent", [1.0, 1.3])
def test_planted_growth_comes_back_through_the_whole_chain(exponent: float) -> None:
    machine = Machine()
    jobs = [make_job(machine, n, 3e-5 + 2e-9 * n**exponent) for n in list_lengths(1_000_000)]
    costs = time_jobs(jobs, rounds=3, clock=machine.clock, rng=np.random.default_rng(1))
    (growth,) = fit_all(make_table("costs", costs))
    assert growth["exponent"] == pytest.approx(exponent, abs=1e-3)
    assert growth["overhead_us"] == pytest.approx(30.0, rel=0.01)
    assert (growth["smallest"], growth["largest"]) == (1000, 1_000_000)


def test_too_few_rounds_and_a_clock_that_stands_still_are_refused() -> None:
    machine = Machine()
    with pytest.raises(ValueError, match="rounds must be 3 or more, got 2"):
        time_jobs(
            [make_job(machine, 10, 1.0)],
            rounds=2,
            clock=machine.clock,
            rng=np.random.default_rng(0),
        )
    with pytest.raises(
        ValueError, match="clock must show more than 0 s for soc321, got 0; take a finer clock"
    ):
        time_jobs(
            [make_job(machine, 10, 0.0)],
            rounds=3,
            clock=machine.clock,
            rng=np.random.default_rng(0),
        )


def test_the_clock_is_the_threads_own_where_that_is_fine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("time.get_clock_info", lambda _: type("Info", (), {"resolution": 1e-9}))
    assert choose_clock()[0] == "thread_time"
    monkeypatch.setattr("time.get_clock_info", lambda _: type("Info", (), {"resolution": 0.0156}))
    name, clock = choose_clock()
    assert name == "perf_counter"
    assert clock() <= clock()


def test_blocks_are_timed_one_by_one_once_the_stream_is_warm() -> None:
    seconds = [1.0] * WARM_UP + [1e-6 * number for number in range(BLOCKS_PER_ROUND, 0, -1)]
    now = iter(np.cumsum([0.0, *(step for one in seconds for step in (one, 0.0))]))
    row = time_blocks("soc321", rounds=1, clock=lambda: next(now), rng=np.random.default_rng(0))
    times = row["median_us"], row["p99_us"], row["worst_us"]
    assert times == pytest.approx((100.5, 198.01, 200.0), abs=1e-3)
    assert (row["blocks"], row["deadline_us"]) == (200, pytest.approx(1333.3, abs=0.1))


def test_state_is_in_bytes_of_64_bit_numbers() -> None:
    rows = {row["reducer"]: row for row in list_resources()}
    assert list(rows) == list(REDUCERS)
    assert rows["pca321"]["state_bytes"] == 8 * 3 * REFERENCE_N
    assert rows["soc321"]["state_bytes"] == 0


def test_memory_is_that_of_the_arrays() -> None:
    memory = measure_memory(ReducerVariant("sax321"), 100_000, np.random.default_rng(0))
    # One axis of three is copied.
    assert memory["relative"] == pytest.approx(1 / 3, rel=0.05)
    assert memory["peak_bytes"] == pytest.approx(8e5, rel=0.05)


def test_32_bit_input_costs_its_rounding_and_no_more() -> None:
    found = compare_precision("dft321", np.random.default_rng(0))
    assert found["output"] == "float64"
    assert found["difference_db"] is not None
    assert -170 < found["difference_db"] < -120


def test_the_machine_is_named(tmp_path: Path) -> None:
    cpu_list = tmp_path / "cpuinfo"
    cpu_list.write_text("processor\t: 0\nmodel name\t: Example CPU\nmodel name\t: Example CPU\n")
    machine = describe_machine("thread_time", cpu_list=cpu_list)
    assert (machine["processor"], machine["clock"]) == ("Example CPU", "thread_time")
    assert machine["cores"] >= 1
    assert machine["numpy"] == np.__version__
    assert describe_machine("given", cpu_list=tmp_path / "absent")["processor"]


def test_a_system_that_does_not_count_load_says_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr("os.getloadavg")
    assert describe_machine("given")["load"] is None
