"""Former place of `ROLES`, kept until all branches are in."""

from feel321.analysis.table.schema import ROLES

__all__ = ["ROLES"]
