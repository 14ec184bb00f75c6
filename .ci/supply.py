"""The supply chain: `hashes`, `install`, `licences`, `advisories` and `sbom` of the versions in constraints.txt.

`install` needs nothing but Python and pip: it runs before anything else is there.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PINS = ROOT / "constraints.txt"
HASHES = ROOT / "hashes.txt"
LICENCES = ROOT / "docs" / "licences.md"
BESIDES = {
    "colorama": ("0.4.6", ["core"], "sys_platform == 'win32'"),
    "editables": ("0.5", ["build"], "python_version >= '3.11'"),
}
"""What an installation on Linux does not keep, of Windows and of the build alone: version, groups, marker."""

HEAD = """\
# SHA-256 of every file that the index offers of the pinned versions, for all systems. Rewrite: make hashes
# Install what a group needs, verified: make verified GROUPS="rig server" (core is always in).
"""
ENTRY = re.compile(
    r"^(?P<name>[\w.-]+)==(?P<version>\S+?)(?: ; (?P<marker>.+?))? \\\n"
    r"(?P<hashes>(?:    --hash=.+\n)+)    # for: (?P<groups>.+)\n",
    re.MULTILINE,
)


def canonicalize(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def read_pins() -> dict[str, str]:
    """Read the pinned versions by canonical name."""
    lines = PINS.read_text(encoding="utf-8").splitlines()
    pins = (line.split("==") for line in lines if "==" in line)
    return {canonicalize(name): version for name, version in pins}


# Who needs what: the closures of the core, the extras and the build, as installed here.


def find_groups() -> dict[str, list[str]]:
    """Find the groups that need each installed package, directly or not."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    roots = {"core": project["project"]["dependencies"]}
    roots |= project["project"]["optional-dependencies"]
    roots |= {"build": project["build-system"]["requires"]}
    groups: dict[str, list[str]] = defaultdict(list)
    for group, requirements in roots.items():
        for name in close(requirements):
            groups[name].append(group)
    return groups


def close(requirements: list[str]) -> set[str]:
    """Find everything that requirements bring, by the metadata of what is installed."""
    from importlib.metadata import distribution

    from packaging.requirements import Requirement

    found: set[tuple[str, str]] = set()
    waiting = [(Requirement(line), "") for line in requirements]
    while waiting:
        requirement, extra = waiting.pop()
        if requirement.marker and not requirement.marker.evaluate({"extra": extra}):
            continue
        name = canonicalize(requirement.name)
        for own in {"", *requirement.extras}:
            if (name, own) not in found:
                found.add((name, own))
                needed = map(Requirement, distribution(name).requires or [])
                waiting += [(one, own) for one in needed]
    return {name for name, _ in found}


def find_markers() -> dict[str, str]:
    """Find the markers of what the project itself requires on some systems or Pythons only."""
    from packaging.requirements import Requirement

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lines = [line for group in project["optional-dependencies"].values() for line in group]
    found = (Requirement(line) for line in lines if ";" in line)
    return {canonicalize(one.name): str(one.marker).replace('"', "'") for one in found}


# Hashes.


def write_hashes() -> None:
    """Write hashes.txt: uv, in an environment of its own, asks the index that pip uses."""
    pins = read_pins() | {name: version for name, (version, *_) in BESIDES.items()}
    hashes = ask_hashes(pins)
    groups = find_groups() | {name: groups for name, (_, groups, _) in BESIDES.items()}
    markers = find_markers() | {name: marker for name, (*_, marker) in BESIDES.items()}
    text = HEAD
    for name in sorted(pins):
        marker = f" ; {markers[name]}" if name in markers else ""
        lines = " \\\n".join(f"    --hash=sha256:{one}" for one in hashes[name])
        wanted = ", ".join(groups.get(name, ["environment"]))
        text += f"{name}=={pins[name]}{marker} \\\n{lines}\n    # for: {wanted}\n"
    HASHES.write_text(text, encoding="utf-8")
    print(f"{HASHES.name}: {len(pins)} packages, {text.count('--hash=')} files")


def ask_hashes(pins: dict[str, str]) -> dict[str, list[str]]:
    with tempfile.TemporaryDirectory(prefix="feel321-uv-") as folder:
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        programs = Path(folder) / ("Scripts" if os.name == "nt" else "bin")
        subprocess.run([programs / "python", "-m", "pip", "install", "-q", "uv"], check=True)
        asked, answered = Path(folder) / "pins.in", Path(folder) / "pins.txt"
        asked.write_text("".join(f"{name}=={version}\n" for name, version in pins.items()))
        command = [programs / "uv", "pip", "compile", "--quiet", "--universal", "--no-deps"]
        command += ["--generate-hashes", "--no-header", "--no-annotate", asked, "-o", answered]
        authorities = (
            {} if "PIP_CERT" not in os.environ else {"SSL_CERT_FILE": os.environ["PIP_CERT"]}
        )
        subprocess.run(command, check=True, env=os.environ | authorities)
        found = answered.read_text(encoding="utf-8")
    entries = re.findall(r"^([\w.-]+)==\S+.*\\\n((?:    --hash=.+\n?)+)", found, re.MULTILINE)
    return {canonicalize(name): re.findall(r"sha256:(\w{64})", lines) for name, lines in entries}


def install(wanted: list[str]) -> None:
    """Install what groups need, each file verified, then feel321 itself from this folder without asking any index."""
    entries = list(ENTRY.finditer(HASHES.read_text(encoding="utf-8")))
    known = {group for entry in entries for group in entry["groups"].split(", ")}
    if unknown := set(wanted) - known:
        sys.exit(
            f"GROUPS: {', '.join(sorted(unknown))} unknown; choose from {', '.join(sorted(known))}"
        )
    chosen = {"core", "build", *wanted}
    with tempfile.TemporaryDirectory(prefix="feel321-pip-") as folder:
        path = Path(folder) / "hashes.txt"
        path.write_text(
            "".join(one[0] for one in entries if chosen & set(one["groups"].split(", ")))
        )
        pip = [sys.executable, "-m", "pip", "install", "--disable-pip-version-check", "-q"]
        own = ["--no-deps", "--no-build-isolation", "-e", str(ROOT)]
        for line in (["--require-hashes", "-r", str(path)], own):
            if code := subprocess.run([*pip, *line], check=False).returncode:
                sys.exit(code)


# Licences.

READ_BY_HAND = {
    "atheris": "Apache-2.0", "meshpy": "Triangle licence", "psychtoolbox": "MIT, with parts under compatible licences",
    "docutils": "public domain, with parts BSD-2-Clause, PSF-2.0, GPL-3.0-or-later",
    "matplotlib": "PSF-like (Matplotlib licence)", "questplus": "GPL-3.0-or-later",
    "psychopy": "GPL-3.0-or-later", "pyqt6-qt6": "LGPL-3.0-only", "ffpyplayer": "LGPL-3.0-only",
    "python-bidi": "LGPL-3.0-or-later", "python-vlc": "LGPL-2.1-or-later", "python-xlib": "LGPL-2.1-or-later",
    "numpy": "BSD-3-Clause", "scipy": "BSD-3-Clause", "cycler": "BSD-3-Clause", "jinja2": "BSD-3-Clause",
    "numpydoc": "BSD-2-Clause", "pip": "MIT", "pip-api": "Apache-2.0",
}  # fmt: skip
"""Licences that the metadata leave out or tell in words of their own; read in the packages' files and projects."""

SPDX = {
    r"MPL-2.0 AND MIT": "MPL-2.0 AND MIT", r"\b(MIT|Expat)\b": "MIT", r"3-clause|revised bsd|kiwi": "BSD-3-Clause",
    r"2-clause": "BSD-2-Clause", r"apache": "Apache-2.0", r"psf|python software": "PSF-2.0",
    r"mozilla|mpl": "MPL-2.0", r"zpl|zope": "ZPL-2.1", r"bsd": "BSD (form not declared)",
}  # fmt: skip
"""Words of the metadata, in this order -> SPDX identifier."""

COPYLEFT = re.compile(r"\b(?:L|A)?GPL|MPL|Triangle")


def write_licences() -> None:
    """Write docs/licences.md: its words, then the table from the installed metadata."""
    command = [sys.executable, "-m", "piplicenses", "--from=all", "--with-system", "--format=json"]
    told = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    pins, groups = read_pins(), find_groups()
    rows = sorted((canonicalize(one["Name"]), name_licence(one)) for one in told)
    text = LICENCES.read_text(encoding="utf-8").partition("| package |")[0]
    text += "| package | version | licence | needed for |\n|---|---|---|---|\n"
    for name, licence in rows:
        if name in pins:
            shown = f"**{licence}**" if COPYLEFT.search(licence) else licence
            text += f"| `{name}` | {pins[name]} | {shown} | {', '.join(groups.get(name, ['environment']))} |\n"
    LICENCES.write_text(text, encoding="utf-8")


def name_licence(told: dict[str, str]) -> str:
    if by_hand := READ_BY_HAND.get(canonicalize(told["Name"])):
        return by_hand
    if (expression := told["License-Expression"]) != "UNKNOWN":
        return expression
    for words in (told["License-Metadata"][:60], told["License-Classifier"]):
        for pattern, identifier in SPDX.items():
            if re.search(pattern, words, re.IGNORECASE):
                return identifier
    return "unknown"


# Advisories and the bill of materials.


def find_advisories() -> None:
    """Compare the pins with published advisories: exit 0 none, 1 some, 3 where they could not be reached."""
    report = audit("json")
    checked = [one for one in report if "skip_reason" not in one]
    found = [(one, flaw) for one in checked for flaw in one["vulns"]]
    for one, flaw in found:
        mended = ", ".join(flaw["fix_versions"]) or "no version yet"
        print(
            f"{one['name']} {one['version']}: {flaw['id']} ({', '.join(flaw['aliases'])}); mended in {mended}"
        )
    print(f"{len(checked)} of {len(report)} packages compared with advisories, {len(found)} found")
    if len(checked) < len(report) / 2:
        print(
            "The advisories could not be reached: this says nothing about the packages",
            file=sys.stderr,
        )
        sys.exit(3)
    sys.exit(bool(found))


def audit(form: str) -> list[dict[str, Any]]:
    """Run pip-audit over the pins; nothing is installed. Where an index has none it skips all."""
    command = [
        sys.executable,
        "-m",
        "pip_audit",
        "--no-deps",
        "--disable-pip",
        "--progress-spinner=off",
    ]
    done = subprocess.run(
        [*command, "-f", form, "-r", str(PINS)], check=False, capture_output=True, text=True
    )
    if not done.stdout.startswith("{"):
        reason = (done.stderr.strip() or "no answer").splitlines()[-1]
        print(f"The advisories could not be reached: {reason[:200]}", file=sys.stderr)
        sys.exit(3)
    return list(json.loads(done.stdout)["dependencies"])


def write_sbom() -> None:
    """Write build/sbom.json, the bill of materials of the core and the extras in CycloneDX 1.6, with hashes."""
    entries = ENTRY.finditer(HASHES.read_text(encoding="utf-8"))
    licences = dict(read_licences())
    components = [
        describe_component(entry, licences.get(entry["name"], "unknown")) for entry in entries
    ]
    name = {"type": "application", "name": "feel321", "licenses": [{"expression": "BSD-3-Clause"}]}
    document = {
        "bomFormat": "CycloneDX", "specVersion": "1.6", "version": 1,
        "metadata": {"component": name}, "components": components,
    }  # fmt: skip
    path = ROOT / "build" / "sbom.json"
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    print(f"{path.relative_to(ROOT)}: {len(components)} components")


def describe_component(entry: re.Match[str], licence: str) -> dict[str, Any]:
    address = f"pkg:pypi/{entry['name']}@{entry['version']}"
    hashes = re.findall(r"sha256:(\w{64})", entry["hashes"])
    return {
        "type": "library", "bom-ref": address, "purl": address, "name": entry["name"],
        "version": entry["version"], "licenses": [{"license": {"name": licence}}],
        "properties": [{"name": "feel321:needed-for", "value": entry["groups"]}]
        + [{"name": "feel321:sha256", "value": one} for one in hashes],
    }  # fmt: skip


def read_licences() -> Iterator[tuple[str, str]]:
    """Read the table of docs/licences.md."""
    for line in LICENCES.read_text(encoding="utf-8").splitlines():
        if line.startswith("| `"):
            name, _, licence, _ = line.strip("| ").split(" | ")
            yield name.strip("`"), licence.strip("*")


VERBS = {
    "hashes": write_hashes, "licences": write_licences, "advisories": find_advisories, "sbom": write_sbom,
}  # fmt: skip

if __name__ == "__main__":
    verb, *arguments = sys.argv[1:] or [""]
    if verb == "install":
        install(arguments)
    elif verb in VERBS and not arguments:
        VERBS[verb]()
    else:
        sys.exit(f"usage: supply.py {' | '.join(VERBS)} | install [GROUP ...]")
