"""Studies: settings, stimuli, sessions and reports in one folder.

Imports nothing heavy: what a step needs is imported when it is called.
"""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from feel321.arguments import import_lazily as _import_lazily
from feel321.study.study import Study

if _TYPE_CHECKING:
    from feel321.study.settings.schema import Settings

__all__ = ["Settings", "Study"]


def __dir__() -> list[str]:
    return sorted(__all__)


__getattr__ = _import_lazily(__name__, __file__)
