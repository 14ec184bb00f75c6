"""Numbers in the design: dense, unique and given again, whoever asks for them and dies."""

import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from feel321.stimuli.sets.manifest import StimulusSet
from feel321.study.folder import StudyFolder
from feel321.study.participants.roster import (
    PLANNED,
    Station,
    find_doubles,
    hold_numbers,
    plan_participants,
    read_holder,
    read_holders,
)
from feel321.study.session.journal import list_journals
from feel321.study.session.plan import PLAN_FILE, Design, Plan, make_plan, require_plan
from feel321.study.withdrawal import release_participant, withdraw_participant


@pytest.fixture
def plan_here(lab: Any, design: Design, stimuli: StimulusSet) -> Any:
    """Plan sessions of a small design in the study; gives participant -> number."""

    def run(*names: str, simulated: bool = False, station: Station | None = None) -> dict[str, int]:
        def make(name: str, number: int) -> Plan:
            return make_plan(design, stimuli, name, number=number, simulated=simulated)

        plans = plan_participants(
            lab.study, names, make, simulated=simulated, station=station or Station()
        )
        return {plan.participant: plan.number for plan in plans}

    return run


def test_numbers_are_given_in_the_order_of_asking_and_kept(lab: Any, plan_here: Any) -> None:
    assert plan_here("b", "a", "b") == {"b": 1, "a": 2}
    assert plan_here("c") == {"c": 3}
    assert plan_here("a", "d") == {"a": 2, "d": 4}
    assert plan_here("sim001", simulated=True) == {"sim001": 1}
    stored = {
        path.parent.name: require_plan(path).number
        for path in lab.study.sessions.glob("*/plan.json")
    }
    assert stored == {"a": 2, "b": 1, "c": 3, "d": 4, "sim001": 1}


def test_the_lowest_freed_number_is_given_again(lab: Any, now: Any) -> None:
    for name in ("p01", "p02", "p03", "p04"):
        lab.begin(name)
    lab.work("p04")
    release_participant(lab.study, "p03", now=now)
    withdraw_participant(lab.study, "p02", now=now)
    assert [lab.claim(name) for name in ("p05", "p06", "p07")] == [2, 3, 5]
    states = {one.participant: (one.number, one.state) for one in read_holders(lab.study)}
    assert states["p02"] == (2, "withdrawn")
    assert states["p03"] == (3, "released")
    assert {states[name] for name in ("p05", "p06", "p07")} == {(n, PLANNED) for n in (2, 3, 5)}
    assert list(find_doubles(read_holders(lab.study))) == []


@pytest.mark.parametrize("block", [1, 2, 6])
@pytest.mark.parametrize("of", [1, 2, 5])
def test_shares_of_stations_are_all_numbers_once(of: int, block: int) -> None:
    shares = [Station(this, of, block) for this in range(1, of + 1)]
    assert all(sum(share.has(number) for share in shares) == 1 for number in range(1, 200))
    # Every station has all groups equally often.
    for share in shares:
        own = [number for number in range(1, 10 * of * block + 1) if share.has(number)]
        assert {(number - 1) % block for number in own[:block]} == set(range(block))


@pytest.mark.parametrize(
    ("names", "simulated", "message"),
    [
        (["p03", "P01"], False, "participant P01: differs from p01 in capitals only"),
        (["p03", "q", "Q"], False, "participant Q: differs from q in capitals only"),
        (["p03", "a b"], False, "participant must be letters, digits, - and _, got 'a b'"),
        (["p03", "p01"], True, "participant p01: was planned as a real one, got a simulated one"),
        (["p03", "gone"], False, "participant gone: was withdrawn; no code is used twice"),
        (["p03", "left"], False, "participant left: was released; no code is used twice"),
    ],
)
def test_who_cannot_be_planned_is_named_and_nobody_is(
    lab: Any, now: Any, plan_here: Any, names: list[str], simulated: bool, message: str
) -> None:
    for name in ("p01", "gone", "left"):
        lab.begin(name)
    withdraw_participant(lab.study, "gone", now=now)
    release_participant(lab.study, "left", now=now)
    with pytest.raises(ValueError, match=message):
        plan_here(*names, simulated=simulated)
    assert not (lab.study.sessions / "p03").exists()


@pytest.mark.parametrize("content", [None, b"", b"{}", b'{"participant": "p01", "number": -1'])
def test_a_number_that_cannot_be_read_is_given_to_nobody(
    lab: Any, plan_here: Any, content: bytes | None
) -> None:
    path = lab.begin("p01") / PLAN_FILE
    path.unlink() if content is None else path.write_bytes(content)
    with pytest.raises(ValueError, match=r"p01/plan\.json: is missing or damaged.*from a copy"):
        plan_here("p02")
    assert read_holder(lab.study.sessions / "nobody") is None


def test_who_has_a_plan_waits_for_nobody(lab: Any, plan_here: Any) -> None:
    plan_here("p01", "p02")
    (lab.study.sessions / "p02" / PLAN_FILE).write_text("{}")
    with hold_numbers(lab.study):  # as somebody who plans thousands
        assert plan_here("p01") == {"p01": 1}


def test_a_release_that_a_power_cut_tore_frees_no_number(lab: Any, now: Any) -> None:
    folder = lab.begin("p01")
    (journal,) = list_journals(folder)
    before = journal.read_bytes()
    release_participant(lab.study, "p01", now=now)
    whole = journal.read_bytes()
    assert read_holder(folder).state == "released"
    journal.write_bytes(whole[: len(whole) - 20])
    assert whole.startswith(before)
    assert read_holder(folder).state == PLANNED


CLAIM = """
import os, signal, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from planned import make_small_plan
from feel321.study.folder import StudyFolder
from feel321.study.participants.roster import Station, plan_participants
study, who, kill_at = StudyFolder(Path(sys.argv[2])), sys.argv[3], int(sys.argv[4])
calls = 0
def watch(event, arguments):
    global calls
    writes = event in {"os.rename", "os.mkdir"} or (event == "open" and arguments[2] & (os.O_WRONLY | os.O_RDWR))
    if writes and study.path.name in str(arguments[0]):
        calls += 1
        if calls == kill_at:
            os.kill(os.getpid(), signal.SIGKILL)
def make(name, number):
    return make_small_plan(name, number=number, simulated=False)
input()
sys.addaudithook(watch)
for place in range(int(sys.argv[5])):
    plan_participants(study, [f"{who}-{place}"], make, simulated=False, station=Station())
"""


def claim(
    study: StudyFolder, who: str, *, kill_at: int = 0, times: int = 1
) -> subprocess.Popen[str]:
    here = Path(__file__).parent
    command = [sys.executable, "-c", CLAIM, here, study.path, who, str(kill_at), str(times)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, text=True)


def read_numbers(study: StudyFolder) -> dict[str, int]:
    return {one.participant: one.number for one in read_holders(study)}


def test_processes_that_ask_at_once_get_dense_and_different_numbers(lab: Any) -> None:
    processes = [claim(lab.study, f"w{place}", times=12) for place in range(5)]
    for process in processes:
        process.communicate("go\n", timeout=120)
    assert [process.returncode for process in processes] == [0] * 5
    numbers = read_numbers(lab.study)
    assert sorted(numbers.values()) == list(range(1, 61))
    for place in range(5):  # each in the order in which it asked
        own = [numbers[f"w{place}-{turn}"] for turn in range(12)]
        assert own == sorted(own)


def test_a_claim_that_is_killed_at_any_call_loses_and_doubles_nothing(lab: Any) -> None:
    lab.claim("p01")
    kills = 0
    for kill_at in range(1, 40):
        process = claim(lab.study, f"k{kill_at}", kill_at=kill_at)
        process.communicate("go\n", timeout=120)
        kills += process.returncode == -signal.SIGKILL
        # Whoever was killed is planned or is not; the next one gets the lowest number that is free.
        numbers = read_numbers(lab.study)
        assert sorted(numbers.values()) == list(range(1, len(numbers) + 1))
        assert lab.claim(f"n{kill_at}") == len(numbers) + 1
        if process.returncode == 0:
            break
    assert kills > 5
    assert process.returncode == 0
    # The same call finishes what was killed.
    before = read_numbers(lab.study)
    left = [f"k{n}-0" for n in range(1, kill_at) if f"k{n}-0" not in before]
    assert [lab.claim(name) for name in left] == [len(before) + 1 + n for n in range(len(left))]
