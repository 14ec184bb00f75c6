"""The one list of protocols: settings, messages and tests iterate it."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

from protocols.abx import ABX
from protocols.dissimilarity import DISSIMILARITY
from protocols.mushra import MUSHRA
from protocols.realism import REALISM
from protocols.similarity import SIMILARITY

if TYPE_CHECKING:
    from collections.abc import Mapping

    from protocols.protocol import Protocol

PROTOCOLS: Mapping[str, Protocol] = MappingProxyType(
    {protocol.name: protocol for protocol in (REALISM, SIMILARITY, DISSIMILARITY, MUSHRA, ABX)}
)
"""Name -> protocol. Later ones are added, none renamed."""
