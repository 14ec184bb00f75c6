"""`data/*.csv`: one file per participant and one row per trial, in the columns that PsychoPy's users know.

Derived from the journals as `ratings.csv` is, and written with it.
"""

from collections.abc import Iterable, Mapping
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

from feel321.files import make_folder, write_table

WIDE = "data"  # folder of the files, in a study's

ONCE = {
    "participant": "participant", "session": "session", "protocol": "trials.protocol", "block": "trials.block",
    "trial": "trials.thisN", "repeat": "trials.thisRepN", "response_time_s": "response.rt", "underruns": "underruns",
    "rejected": "rejected", "simulated": "simulated",
}  # fmt: skip
"""Column of a judgement -> column of a trial."""

EACH = {
    "stimulus_id": "stimulus", "recording": "recording", "reducer": "reducer", "level": "level",
    "reference_id": "reference", "scale": "scale", "rating": "response", "onset_s": "started",
}  # fmt: skip
"""Column of a judgement -> column of each judgement in a trial, which ends in its number."""


def write_wide(study: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write the trials of each participant, and remove the files of those who are no longer there."""
    folder = study / WIDE
    people = {name: list(own) for name, own in groupby(rows, itemgetter("participant"))}
    own_start = ",".join(ONCE.values()).encode()
    foreign = set()  # a recording, or a table of the lab's own, that lies here is left
    for path in folder.glob("*.csv"):
        if not path.read_bytes().startswith(own_start):
            foreign.add(path.stem)
        elif path.stem not in people:
            path.unlink()  # of nobody here
    if people:
        make_folder(folder, private=True)
    if taken := sorted(foreign & people.keys()):
        raise FileExistsError(f"{folder / taken[0]}.csv: is not feel321's; move it away")
    for name, own in people.items():
        key = itemgetter("session", "trial", "response_time_s")
        trials = [list(one) for _, one in groupby(own, key)]
        numbers = range(1, max(map(len, trials)) + 1)
        columns = [*ONCE.values(), *(f"{column}_{k}" for k in numbers for column in EACH.values())]
        write_table(folder / f"{name}.csv", columns, map(_widen, trials), private=True)


def _widen(judgements: list[Mapping[str, Any]]) -> dict[str, Any]:
    row = {column: judgements[0][name] for name, column in ONCE.items()}
    for number, one in enumerate(judgements, start=1):
        row |= {f"{column}_{number}": one[name] for name, column in EACH.items()}
    return row
