"""Rating tasks: comparisons, orders, balance, scores, and the steps of a session.

Knows nothing of signals, screens or files: a trial names a stimulus by its id.
"""

from feel321.protocols.order import ORDERS, make_order
from feel321.protocols.tasks import PROTOCOLS
from feel321.protocols.trial import Item

__all__ = ["ORDERS", "PROTOCOLS", "Item", "make_order"]


def __dir__() -> list[str]:
    return __all__
