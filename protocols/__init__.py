"""Rating tasks: what is judged against what, in which order, in which words, and what comes next.

Knows nothing of signals, screens or files: a trial names a stimulus by its id.
"""

from protocols.agenda import Agenda
from protocols.balance import Balance, measure_balance
from protocols.design import ORDERS, make_order
from protocols.flow import Flow, Page
from protocols.protocol import Protocol, Task
from protocols.registry import PROTOCOLS
from protocols.rehearsal import make_rehearsal
from protocols.scoring import is_as_expected, score_trial
from protocols.square import williams_square
from protocols.tasks import make_task
from protocols.texts import PageText, list_languages, read_pages, read_refusals, read_scales
from protocols.trial import RATING_RANGE, Comparison, Item, Judgement, Part, Scale, Trial

__all__ = [
    "ORDERS",
    "PROTOCOLS",
    "RATING_RANGE",
    "Agenda",
    "Balance",
    "Comparison",
    "Flow",
    "Item",
    "Judgement",
    "Page",
    "PageText",
    "Part",
    "Protocol",
    "Scale",
    "Task",
    "Trial",
    "is_as_expected",
    "list_languages",
    "make_order",
    "make_rehearsal",
    "make_task",
    "measure_balance",
    "read_pages",
    "read_refusals",
    "read_scales",
    "score_trial",
    "williams_square",
]
