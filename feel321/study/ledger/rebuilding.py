"""Old place of what is in `slots` and `standing`; kept until all branches are in."""

from feel321.study.ledger.slots import (
    find_lost,
    open_study_ledger,
    read_study_ledger,
    rebuild_ledger,
)
from feel321.study.ledger.standing import find_leftovers

__all__ = [
    "find_leftovers",
    "find_lost",
    "open_study_ledger",
    "read_study_ledger",
    "rebuild_ledger",
]
