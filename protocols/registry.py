"""The one list of protocols: settings, messages and tests iterate it."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

from protocols.realism import REALISM
from protocols.similarity import SIMILARITY

if TYPE_CHECKING:
    from collections.abc import Mapping

    from protocols.trial import Protocol

PROTOCOLS: Mapping[str, Protocol] = MappingProxyType({p.name: p for p in (REALISM, SIMILARITY)})
"""Name -> protocol. Later ones are added, none renamed."""
