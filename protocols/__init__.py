"""Rating tasks: what is judged against what, in which order, in which words.

Knows nothing of signals, screens or files: a trial names a stimulus by its id.
"""

from protocols.design import make_order, williams_square
from protocols.registry import PROTOCOLS
from protocols.texts import list_languages, read_scales
from protocols.trial import RATING_RANGE, Comparison, Item, Protocol, Scale, Trial

__all__ = [
    "PROTOCOLS",
    "RATING_RANGE",
    "Comparison",
    "Item",
    "Protocol",
    "Scale",
    "Trial",
    "list_languages",
    "make_order",
    "read_scales",
    "williams_square",
]
