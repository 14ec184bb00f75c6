"""The engine, run on a journal: what no session can have written is found, and what any session can write is not."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from feel321.protocols.tasks import PROTOCOLS
from feel321.protocols.trial import Scale, Trial
from feel321.study.session.events import ClockStepped, DeviceOpened, LineRecovered, SessionAborted
from feel321.study.session.journal import Record
from feel321.study.session.plan import Plan
from feel321.study.session.ports import Abort, Act, Confirm, Feel, Move, Pause, Place, Playback

Find = Callable[..., list[str]]
Present = Callable[..., list[Record]]

JUNK: tuple[Any, ...] = (None, "x", -1, 10**6, 0.5, True, [], {}, [1], {"a": None})


def find_place(records: list[Record], event: str) -> int:
    return next(place for place, record in enumerate(records) if record.event == event)


def edit(records: list[Record], event: str, /, **changes: Any) -> list[Record]:
    """Change the first record of an event."""
    place = find_place(records, event)
    record = records[place]
    return [
        *records[:place],
        replace(record, data={**record.data, **changes}),
        *records[place + 1 :],
    ]


def drop(records: list[Record], *places: int) -> list[Record]:
    return [record for place, record in enumerate(records) if place not in places]


def put(records: list[Record], place: int, event: str, **data: Any) -> list[Record]:
    return [*records[:place], Record(0, records[place - 1].utc, event, data), *records[place:]]


@pytest.mark.parametrize("name", [*PROTOCOLS, "similarity-strict"])
def test_a_session_in_which_much_goes_wrong_gives_no_finding(
    present: Present, scripted: type, find: Find, plan_task: Callable[..., Plan], name: str
) -> None:
    name, _, timing = name.partition("-")
    plan = plan_task(name, **({"timing": timing} if timing else {}), training=2, practice=1)
    quick = Confirm(0.0, {}, 0.1)
    cut, dry = Playback(1.0, 1.0, completed=False), Playback(1.0, 1.2, underruns=2, clipped=1)

    class Patient(scripted):  # type: ignore[misc] - a fixture hands the class over
        """Who feels everything again and answers, after what the script holds."""

        def show_trial(self, trial: Trial, scale: Scale, place: Place) -> None:
            super().show_trial(trial, scale, place)
            self.answers = dict.fromkeys(trial.judged, "a" if scale.choices else 50.0)

        def wait(self) -> Act:
            self._waiting = self._waiting or [Feel(0.0, ""), Confirm(0.0, self.answers, 1.5)]
            act = super().wait()
            return (
                replace(act, values=self.answers)
                if act == replace(quick, time_s=act.time_s)
                else act
            )

    moves = [
        Feel(0.0, ""),
        Move(0.0, plan.trials[0].judgements[0].part, 5.0),
        Feel(0.0, "no such part"),
    ]
    first = Patient(
        acts={
            (1, 1): [*moves, quick],
            (2, 1): [Feel(0.0, ""), Pause(0.0)],
            (3, 1): [Abort(0.0, "had enough")],
        },
        playbacks={(1, 2): [dry], (1, 1): [cut], (4, 1): [Playback(1.0, None, error="gone")]},
        pages={"main": [Pause(0.0)], "training": [Abort(0.0, "a break")]},
    )
    present(first, plan=plan)
    present(first, plan=plan)
    for stop_after in (1, 2):
        with pytest.raises(KeyboardInterrupt):
            present(Patient(stop_after=stop_after), plan=plan)
    wrong = {(number, attempt): [dry, cut] for number in range(1, 9) for attempt in range(1, 4)}
    failing = {(number, 1): [Playback(1.0, None, error="gone")] for number in (7, 8)}
    present(
        Patient(playbacks=wrong | failing, acts={(5, 1): [Feel(0.0, ""), Pause(0.0)]}), plan=plan
    )
    records = present(Patient(), plan=plan)
    events = {record.event for record in records}
    assert records[-1].event == "finished"
    assert {"aborted", "resumed", "refused", "paused", "continued"} <= events
    assert "spoiled" in events or name == "mushra", "its few trials end before a device fails"
    assert find(records, plan) == []


def is_at(records: list[Record], event: str, name: str, value: Any) -> int:
    """Find the place of the first record of an event that says so."""
    return next(
        place
        for place, one in enumerate(records)
        if one.event == event and one.data.get(name) == value
    )


def edit_rest(records: list[Record]) -> list[Record]:
    place = is_at(records, "page", "key", "rest")
    short = replace(records[place], data={**records[place].data, "stood_s": 2.0})
    return [*records[:place], short, *records[place + 1 :]]


FORGED: dict[str, tuple[int | None, Callable[[list[Record]], list[Record]]]] = {
    "a page after the end": (81, lambda r: put(r, len(r), "page", key="end", time_s=1.0, stood_s=1.0)),
    "resumed after the end": (81, lambda r: put(r, len(r), "resumed")),
    "begun twice": (4, lambda r: put(r, 3, "begun", **r[0].data)),
    "no header": (1, lambda r: r[1:]),
    "an event that is none": (4, lambda r: put(r, 3, "noted")),
    "resumed after released": (5, lambda r: put(put(r, 3, "released"), 4, "resumed")),
    "resumed after superseded": (5, lambda r: put(put(r, 3, "superseded", by=2), 4, "resumed")),
    "gone on without being resumed": (9, lambda r: put(r, find_place(r, "rated"), "aborted", reason="", time_s=1.0)),
    "not shown": (6, lambda r: drop(r, find_place(r, "shown"))),
    "another trial shown": (6, lambda r: edit(r, "shown", trial=2)),
    "another trial rated": (8, lambda r: edit(r, "rated", trial=2)),
    "another attempt rated": (8, lambda r: edit(r, "rated", attempt=2)),
    "not played": (7, lambda r: drop(r, find_place(r, "played"))),
    "not felt to its end": (8, lambda r: edit(r, "played", completed=False)),
    "felt while the device failed": (8, lambda r: edit(r, "played", error="gone")),
    "not felt again after a pause": (
        9,
        lambda r: put(r, find_place(r, "rated"), "paused", trial=1, attempt=1, time_s=1.0),
    ),
    "a part that is none": (7, lambda r: edit(r, "played", part="a")),
    "a playback that stands there twice": (
        8,
        lambda r: put(r, find_place(r, "rated"), "played", **r[find_place(r, "played")].data),
    ),
    "more than 100 points": (8, lambda r: edit(r, "rated", values={"test": 100.5})),
    "less than 0 points": (8, lambda r: edit(r, "rated", values={"test": -0.5})),
    "a choice where there is a slider": (8, lambda r: edit(r, "rated", values={"test": "a"})),
    "no answer": (8, lambda r: edit(r, "rated", values={})),
    "one answer too many": (8, lambda r: edit(r, "rated", values={"test": 1.0, "b": 1.0})),
    "a flag too many": (8, lambda r: edit(r, "rated", flags=["underrun"])),
    "a flag too few": (8, lambda r: edit(r, "played", underruns=3)),
    "too fast": (8, lambda r: edit(r, "rated", response_time_s=0.1)),
    "rejected for nothing": (8, lambda r: edit(r, "rated", rejected=True)),
    "spoiled by nothing": (
        8,
        lambda r: put(
            r, find_place(r, "rated"), "spoiled", trial=1, attempt=1, flags=[], time_s=1.0
        ),
    ),
    "finished too early": (79, lambda r: r[:-2] + r[-1:]),
    "a trial given up": (80, lambda r: edit(r, "finished", given_up=1)),
    "another page": (2, lambda r: edit(r, "page", key="rest")),
    "a page aside that nothing gave reason for": (
        4,
        lambda r: put(r, 3, "page", key="ready", time_s=1.0, stood_s=1.0),
    ),
    "a rest cut short": (None, edit_rest),
}  # fmt: skip


@pytest.mark.parametrize("what", FORGED)
def test_what_no_session_writes_is_found_at_its_line(
    finished: list[Record], find: Find, what: str
) -> None:
    line, forge = FORGED[what]
    line = line or is_at(finished, "page", "key", "rest") + 1
    (found,) = find(forge(finished))
    assert found.startswith(f", line {line}: ")


def test_a_rejection_that_was_undone_is_found(present: Present, scripted: type, find: Find) -> None:
    records = present(scripted(playbacks={(1, 1): [Playback(1.0, 1.2, underruns=1)]}))
    assert find(records) == []
    (found,) = find(edit(records, "rated", rejected=False))
    assert "has rejected False" in found


def test_mending_and_ctrl_c_may_follow_the_end(finished: list[Record], find: Find) -> None:
    for event in (
        LineRecovered(3, "x"),
        ClockStepped(0.5),
        DeviceOpened({}),
        SessionAborted("", 1.0),
    ):
        assert find(put(finished, len(finished), event.event, **event.to_data())) == []


@pytest.mark.parametrize("event", ["begun", "page", "shown", "played", "rated", "finished"])
def test_no_record_whatever_it_holds_is_more_than_a_finding(
    finished: list[Record], find: Find, event: str
) -> None:
    place = find_place(finished, event)
    record = finished[place]
    forged: list[Record] = [replace(record, data=junk) for junk in JUNK]
    for name in record.data:
        forged += [replace(record, data={**record.data, name: junk}) for junk in JUNK]
        forged.append(
            replace(record, data={key: value for key, value in record.data.items() if key != name})
        )
    forged += [replace(record, event=junk) for junk in JUNK]
    for other in forged:
        assert len(find([*finished[:place], other, *finished[place + 1 :]])) <= 1
