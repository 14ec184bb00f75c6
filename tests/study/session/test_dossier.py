from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from feel321.study.session.journal import digest
from feel321.study.session.plan import create_plan, read_dossier, require_own_plan

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.study.session.plan import Plan


def test_a_plan_is_read_with_all_journals(plan: Plan, tmp_path: Path) -> None:
    (folder := tmp_path / "p01").mkdir()
    create_plan(folder / "plan.json", plan)
    dossier = read_dossier(folder)
    assert (dossier.plan, dossier.chains, dossier.records) == (plan, (), [])


@pytest.mark.parametrize("entry", [{}, {"format": 2}, {"format": 2, "flow": None}])
def test_a_plan_of_another_make_is_refused_in_words_though_its_digest_is_right(
    entry: object, tmp_path: Path
) -> None:
    body = json.dumps(entry, indent=1).encode().removesuffix(b"}").rstrip(b"\n") + b"\n}"
    path = tmp_path / "plan.json"
    path.write_bytes(
        body.removesuffix(b"\n}") + b',\n "sha256": "' + digest(body).encode() + b'"\n}\n'
    )
    with pytest.raises(ValueError, match=r"plan\.json: ") as caught:
        require_own_plan(tmp_path)
    assert "\n" not in str(caught.value)
