"""Rating tasks: what is judged against what, in which order, in which words, and what comes next.

Knows nothing of signals, screens or files: a trial names a stimulus by its id.
"""

from feel321.protocols.agenda import Agenda
from feel321.protocols.balance import Balance, measure_balance, williams_square
from feel321.protocols.order import ORDERS, make_order, make_rehearsal
from feel321.protocols.tasks import PROTOCOLS, is_as_expected, make_task, score_trial
from feel321.protocols.texts import PageText, list_languages, read_pages, read_refusals, read_scales
from feel321.protocols.trial import (
    RATING_RANGE,
    Comparison,
    Flow,
    Item,
    Judgement,
    Page,
    Part,
    Protocol,
    Scale,
    Task,
    Trial,
)

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
