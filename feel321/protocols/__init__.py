"""Rating tasks: comparisons, orders, balance, scores, and the steps of a session.

Knows nothing of signals, screens or files: a trial names a stimulus by its id.
"""

from feel321.protocols.balance import Balance, measure_balance
from feel321.protocols.order import ORDERS, make_order
from feel321.protocols.tasks import PROTOCOLS, make_task, score_trial
from feel321.protocols.trial import Flow, Item, Task, Trial

__all__ = [
    "ORDERS",
    "PROTOCOLS",
    "Balance",
    "Flow",
    "Item",
    "Task",
    "Trial",
    "make_order",
    "make_task",
    "measure_balance",
    "score_trial",
]


def __dir__() -> list[str]:
    return __all__
