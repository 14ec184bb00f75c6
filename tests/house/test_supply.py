"""The supply chain: hashes and licences belong to the pins, workflows trust nobody, wheels are reproducible."""

from __future__ import annotations

import json
import os
import re
import runpy
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

if TYPE_CHECKING:
    from pathlib import Path

WORKFLOWS = ".github/workflows"
FULL_COMMIT = re.compile(r"[\w./-]+@[0-9a-f]{40}")


@pytest.fixture(scope="module")
def supply(root: Path) -> dict[str, Any]:
    return runpy.run_path(str(root / ".ci" / "supply.py"))


@pytest.fixture(scope="module")
def entries(supply: dict[str, Any]) -> dict[str, dict[str, str]]:
    text = supply["HASHES"].read_text(encoding="utf-8")
    return {entry["name"]: entry.groupdict() for entry in supply["ENTRY"].finditer(text)}


def test_hashes_belong_to_the_pins(supply: dict[str, Any], entries: Any) -> None:
    beside = {name: version for name, (version, *_) in supply["BESIDES"].items()}
    versions = {name: entry["version"] for name, entry in entries.items()}
    assert versions == supply["read_pins"]() | beside


def test_every_entry_has_hashes_and_nothing_else(supply: dict[str, Any], entries: Any) -> None:
    text = supply["HASHES"].read_text(encoding="utf-8")
    assert supply["HEAD"] + "".join(match[0] for match in supply["ENTRY"].finditer(text)) == text
    lines = [line for entry in entries.values() for line in entry["hashes"].splitlines()]
    assert [
        one for one in lines if not re.fullmatch(r" {4}--hash=sha256:[0-9a-f]{64}( \\)?", one)
    ] == []
    assert "://" not in text
    assert all(entry["groups"] for entry in entries.values())


def test_what_a_group_names_is_in_it(pyproject: Any, entries: Any) -> None:
    project = pyproject["project"]
    groups = {"core": project["dependencies"], "build": pyproject["build-system"]["requires"]}
    for group, lines in (groups | project["optional-dependencies"]).items():
        names = {canonicalize_name(Requirement(line).name) for line in lines}
        assert [one for one in names if group not in entries[one]["groups"].split(", ")] == []


def test_licences_are_those_of_the_pins(supply: dict[str, Any], root: Path) -> None:
    page = (root / "docs" / "licences.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(.+?)` \| (\S+) \| (.+?) \| (.+?) \|$", page, re.MULTILINE)
    assert {name: version for name, version, *_ in rows} == supply["read_pins"]()
    assert [name for name, _, licence, _ in rows if "unknown" in licence.casefold()] == []
    copyleft = {name for name, _, licence, _ in rows if licence.startswith("**")}
    assert copyleft >= {"psychopy", "soxr", "psycopg", "questplus", "pyqt6", "pylint"}
    core = {name for name, _, licence, groups in rows if "GPL" in licence and "core" in groups}
    assert core == {"soxr"}  # which the page's words rest on


@pytest.mark.parametrize(
    ("report", "code", "said"),
    [
        ([{"name": "a", "skip_reason": "not found"}], 3, "could not be reached"),
        ([{"name": "a", "version": "1", "vulns": []}], 0, "1 of 1 packages"),
        (
            [{"name": "a", "version": "1", "vulns": [{"id": "X-1", "aliases": [], "fix_versions": ["2"]}]}],
            1,
            "a 1: X-1",
        ),
    ],
)  # fmt: skip
def test_an_index_without_advisories_is_no_clean_bill(
    supply: dict[str, Any], capsys: pytest.CaptureFixture[str], report: Any, code: int, said: str
) -> None:
    find = supply["find_advisories"]
    find.__globals__["audit"] = lambda _form: report
    with pytest.raises(SystemExit) as ended:
        find()
    assert int(ended.value.code or 0) == code
    assert said in "".join(capsys.readouterr())


def find_faults(workflow: dict[Any, Any]) -> list[str]:
    """List what a workflow grants to strangers: True is what YAML makes of the word `on`."""
    found = [f"{event} gives secrets" for event in workflow[True] if event == "pull_request_target"]
    if workflow.get("permissions") != {"contents": "read"}:
        found.append("permissions")
    for name, job in workflow["jobs"].items():
        found += [f"{name}: {key}" for key in ("permissions", "secrets") if key in job]
        if "timeout-minutes" not in job:
            found.append(f"{name}: no time limit")
        uses = [step["uses"] for step in job["steps"] if "uses" in step]
        found += [f"{name}: {one}" for one in uses if not FULL_COMMIT.fullmatch(one)]
    return found


def test_workflows_trust_nobody(root: Path) -> None:
    files = list((root / WORKFLOWS).glob("*.yml"))
    assert files
    for path in files:
        text = path.read_text(encoding="utf-8")
        assert find_faults(yaml.safe_load(text)) == []
        assert "secrets." not in text
        # What a stranger can name may not become a command.
        assert [
            line for line in text.splitlines() if "${{" in line and "github.event" in line
        ] == []
        for target in re.findall(r"run: make (\w+)", text):
            assert re.search(rf"^{target}:", (root / "Makefile").read_text(), re.MULTILINE)


def test_a_fault_is_found() -> None:
    text = "on: [pull_request_target]\njobs: {a: {steps: [{uses: some/thing@v4}], permissions: write-all}}"
    assert len(find_faults(yaml.safe_load(text))) == 5


@pytest.mark.soak
def test_two_wheels_are_the_same_bytes(root: Path, tmp_path: Path) -> None:
    """Built from this folder and from a copy that has other times and rights."""
    copy = tmp_path / "copy"
    subprocess.run(["git", "clone", "-q", root, copy], check=True)
    told = []
    for source in (root, copy):
        target = tmp_path / f"of-{source.name}"
        command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", target]
        environment = os.environ | {"SOURCE_DATE_EPOCH": "0"}
        subprocess.run(command, cwd=source, check=True, capture_output=True, env=environment)
        told.append(next(target.glob("*.whl")).read_bytes())
    assert told[0] == told[1]


def test_the_bill_of_materials_lists_every_entry(
    supply: dict[str, Any], entries: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write = supply["write_sbom"]
    write.__globals__["ROOT"] = tmp_path
    write()
    assert f"{len(entries)} components" in capsys.readouterr().out
    told = json.loads((tmp_path / "build" / "sbom.json").read_text(encoding="utf-8"))
    assert (told["bomFormat"], told["specVersion"]) == ("CycloneDX", "1.6")
    assert {one["name"]: one["version"] for one in told["components"]} == {
        name: entry["version"] for name, entry in entries.items()
    }
    by_name = {one["name"]: one for one in told["components"]}
    assert by_name["psychopy"]["licenses"] == [{"license": {"name": "GPL-3.0-or-later"}}]
