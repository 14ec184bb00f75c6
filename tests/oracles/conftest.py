"""Reference data that lie beside the checkout."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

SHARED = Path(__file__).parents[3] / "shared"


@pytest.fixture
def open_oracle() -> Callable[..., tuple[Path, dict[str, Any]]]:
    """Find a folder of reference data, and read the expected numbers in its file; skip loudly where it is missing."""

    def find(*parts: str) -> tuple[Path, dict[str, Any]]:
        path = SHARED.joinpath(*parts)
        if not path.is_file():
            where = "/".join(parts)
            pytest.skip(f"ORACLE NOT CHECKED: {where} is not beside this checkout, in shared")
        return path.parent, json.loads(path.read_text(encoding="utf-8"))

    return find
