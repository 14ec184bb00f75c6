"""Old place of what is in `slots` and `standing`; kept until all branches are in."""

from feel321.study.ledger.slots import Entry, list_forgotten
from feel321.study.ledger.standing import Anchor, check_anchors, find_cut, read_anchor

__all__ = ["Anchor", "Entry", "check_anchors", "find_cut", "list_forgotten", "read_anchor"]
