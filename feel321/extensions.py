"""Extensions: a lab's own reducer, metric or protocol, found by one look-up.

A method is given as

- an entry point's name (groups of `GROUPS`), from an installed package;
- a dotted name, `mylab.haptics:my321`;
- a file of the study, `methods/my321.py:my321`;
- a table of `study.toml`, `[reducers.my321]`, with `use = "..."`, one of the above, or `command = "..."`, any program;
- a function, in Python.

The name behind the colon, or that of the table or entry point, is what stands in manifests, file names and tables; one
that is taken is refused. A method is recorded with the SHA-256 digest of its code: a file and what it imports from
its folder, every `*.py` of a package, the source of a function, or a command line and the files that it names.

The code of a lab is called by `call` only: whatever it raises or prints, and however it ends, becomes one line.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import importlib
import importlib.util
import inspect
import os
import shlex
import sys
import threading
import traceback
import types
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from pathlib import Path
from re import fullmatch
from typing import Any, Literal

from feel321.arguments import describe, refuse_name
from feel321.files import clip

GROUPS: Mapping[str, str] = {  # kind of method -> group of entry points; the only list of kinds
    "reducer": "feel321.reducers",
    "metric": "feel321.metrics",
    "protocol": "feel321.protocols",
}

OWN_FORMS = "mylab.haptics:my321, or methods/my321.py:my321"
FORMS = f"a registered name, {OWN_FORMS}"  # how a method is given, for messages
LONGEST_REASON = 203  # characters of a lab's own error message that are repeated

_TURN = threading.RLock()
"""Held while a lab's code runs: standard output belongs to the process, and few functions expect two callers."""

Origin = Literal["file", "module", "function", "command"]


@dataclass(frozen=True, slots=True)
class Method:
    """A lab's own method: picklable, and equal to another that has the same name and the same code."""

    kind: str
    name: str
    place: str  # as it was given
    sha256: str
    origin: Origin
    facts: tuple[tuple[str, Any], ...] = ()  # what its table declares
    folder: Path | None = field(default=None, compare=False, repr=False)  # of the study
    function: Any = field(default=None, compare=False, repr=False)  # as it was given in Python

    def __str__(self) -> str:
        """Name it as messages do."""
        return f"{self.kind} {self.name}"

    @property
    def is_python(self) -> bool:
        """Whether it is imported and called."""
        return self.origin != "command"

    def load(self) -> Any:  # noqa: ANN401 - whatever the lab wrote
        """Import it, once per process; a class is called without arguments for its object."""
        if self.origin == "function":
            return self.function
        if not self.is_python:
            raise TypeError(f"{self}: {self.place} is no Python, and not imported")
        return _load(self, self.folder)

    def find_fact(self, name: str, otherwise: Any = None) -> Any:  # noqa: ANN401 - a fact of any type
        """Find what the table, or else an attribute of the object, declares."""
        declared = dict(self.facts)
        if name in declared or not self.is_python:
            return declared.get(name, otherwise)
        return getattr(self.load(), name, otherwise)

    def to_json(self) -> dict[str, Any]:
        """Return what manifests, plans and journals record."""
        return {"method": self.place, "sha256": self.sha256}


def find_method(
    kind: str,
    given: object,
    *,
    taken: Collection[str] = (),
    folder: Path | None = None,
    declared: Mapping[str, Mapping[str, Any]] | None = None,
) -> Method:
    """Find a lab's method, not imported yet; taken: feel321's own names, declared: the study's tables, by name."""
    folder, tables = Path(folder or Path.cwd()).resolve(), declared or {}
    if isinstance(given, Method):
        found = given
    elif not isinstance(given, str):
        found = _find_function(kind, given)
    elif given in tables:
        found = _find_declared(kind, given, tables[given], folder=folder)
    else:
        found = _find_named(kind, given, folder=folder, known=[*taken, *tables])
    name, what = found.name, f"{kind} {found.place!r}"
    if not fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,59}", name):
        remedy = "give it a name with def" if found.origin == "function" else "rename it"
        must = "up to 60 letters (A-Z), digits and _, beginning with a letter"
        raise ValueError(f"{what}: its name must be {must}, got {name!r}; {remedy}")
    if name.casefold() in {one.casefold() for one in taken}:
        raise ValueError(f"{what}: the name {name!r} is taken by one of feel321's own; rename it")
    return found


def is_given(kind: str, name: str, declared: Collection[str] = ()) -> bool:
    """Whether a name can be one of a lab's methods: a place, a table's name, or an entry point's."""
    return ":" in name or name in declared or name in list_entry_points(kind)


def list_entry_points(kind: str) -> Mapping[str, str]:
    """List the methods of installed packages: name -> dotted name."""
    return _read_entry_points(kind, tuple(sys.path))


@cache  # to look through all packages takes longer than to read a short recording
def _read_entry_points(kind: str, path: tuple[str, ...]) -> Mapping[str, str]:  # noqa: ARG001 - where packages are
    from importlib.metadata import entry_points

    found: dict[str, str] = {}
    for point in sorted(entry_points(group=GROUPS[kind]), key=lambda one: (one.name, one.value)):
        if (first := found.setdefault(point.name, point.value)) != point.value:
            both = f"is declared by two installed packages, as {first} and {point.value}"
            what = f"{kind} {point.name!r} {both}"
            raise ValueError(f"{what}; uninstall one, or name it by its place")
    return types.MappingProxyType(found)


def _find_declared(kind: str, name: str, table: Mapping[str, Any], *, folder: Path) -> Method:
    """Find the method of a table of the study."""
    own = {key: value for key, value in table.items() if value is not None}
    forms = {form: own.pop(form) for form in ("use", "command") if form in own}
    if len(forms) != 1:
        must = 'its table must say either use = "..." or command = "..."'
        raise ValueError(f"{kind} {name!r}: {must}; use takes {FORMS}")
    (form, place), facts = *forms.items(), tuple(sorted(own.items()))
    if form == "use":
        found = _find_named(kind, place, folder=folder)
        return replace(found, name=name, facts=facts, folder=folder)
    # The files of the study that the command names are part of its code.
    words = {part for word in split_command(kind, name, place) for part in (word, *word.split())}
    files = {}
    for word in words:
        with contextlib.suppress(OSError, ValueError):
            path = folder / word
            if path.is_file() and path.resolve().is_relative_to(folder):
                files[word] = path
    return Method(kind, name, place, _digest(files, place), "command", facts, folder)


def _find_named(kind: str, given: str, *, folder: Path, known: Collection[str] = ()) -> Method:
    """Find a method by the name of an entry point, or by its place."""
    place, home = given, folder if ":" in given else None
    if home is None:
        points = list_entry_points(kind)
        if given not in points:
            refusal = refuse_name(given, [*known, *points], kind)
            raise ValueError(f"{refusal}; one of your own: {OWN_FORMS}")
        place = points[given]
    origin, sha256 = _digest_place(kind, place, home)
    return Method(kind, given.rpartition(":")[2], place, sha256, origin, folder=home)


def _find_function(kind: str, given: object) -> Method:
    if not callable(given):
        raise TypeError(f"{kind} must be {FORMS}, or a function; got {describe(given)}")
    named = given if hasattr(given, "__qualname__") else type(given)
    module, name = getattr(named, "__module__", "") or "", getattr(named, "__qualname__", "")
    short = getattr(given, "__name__", name).rpartition(".")[2]
    try:
        source = inspect.getsource(named)
    except (OSError, TypeError):
        source = repr(getattr(getattr(given, "__code__", None), "co_code", short))
    return Method(kind, short, f"{module}.{name}", _digest({}, source), "function", function=given)


# Digests: of all the code that a method may consist of.


def _digest_place(kind: str, place: str, folder: Path | None) -> tuple[Origin, str]:
    """Find the code of a place: where it is, and its digest."""
    where = place.rpartition(":")[0]
    if where.endswith(".py") and folder is not None:
        path = (folder / where).resolve()
        if Path(where).is_absolute() or not path.is_relative_to(folder):
            must = "must be a file in the study's folder, such as methods/my321.py:my321"
            raise ValueError(f"{kind} {place!r}: {must}; copy it there")
        if not path.is_file():
            what = f"there is no file {where} in {folder}"
            raise ValueError(f"{kind} {place!r}: {what}; check the name")
        return "file", _digest_file(path)
    if not fullmatch(r"\w+(\.\w+)*", where):
        raise ValueError(f"{kind} {place!r}: not a method; allowed: {FORMS}")
    return "module", _digest_module(kind, place, folder)


def _digest(files: Mapping[str, Path], start: str = "") -> str:
    digest = hashlib.sha256(start.encode())
    for name in sorted(files):
        content = files[name].read_bytes()
        digest.update(f"{name}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()


def _digest_file(path: Path) -> str:
    """Digest a file, and what it imports from its own folder: modules, and packages whole."""
    found: dict[str, Path] = {}
    waiting, folder = [path], path.parent
    while waiting:
        one = waiting.pop()
        if (name := one.relative_to(folder).as_posix()) in found:
            continue
        found[name] = one
        try:
            nodes = [*ast.walk(ast.parse(one.read_bytes()))]
        except (SyntaxError, ValueError, RecursionError):
            continue  # as loading it tells
        names = {a.name for node in nodes if isinstance(node, ast.Import) for a in node.names}
        names |= {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
        for top in {name.partition(".")[0] for name in names} - {""}:
            is_package = (folder / top / "__init__.py").is_file()
            waiting += [folder / f"{top}.py"] if (folder / f"{top}.py").is_file() else []
            waiting += (folder / top).rglob("*.py") if is_package else ()
    return _digest(found)


def _digest_module(kind: str, place: str, folder: Path | None = None) -> str:
    """Digest the top package of a dotted name, or its one module."""
    module, _, name = place.partition(":")
    top = module.partition(".")[0]
    spec = None
    with contextlib.suppress(ImportError, ValueError, AttributeError), _on_path(folder):
        spec = importlib.util.find_spec(top)
    if spec is None or not name:
        why = f"cannot be imported: no module named {top!r}"
        do = "install it, or name a file in the study, methods/my321.py:my321"
        raise ValueError(f"{kind} {place!r} {why}; {do}")
    homes = [Path(home) for home in spec.submodule_search_locations or ()]
    paths = {path: home for home in homes for path in home.rglob("*.py")}
    files = {path.relative_to(home).as_posix(): path for path, home in paths.items()}
    if not homes and spec.origin is not None and Path(spec.origin).is_file():
        files = {Path(spec.origin).name: Path(spec.origin)}
    return _digest(files, "" if homes or files else f"{module} of Python {sys.version}")


def split_command(kind: str, name: str, command: str) -> list[str]:
    """Split a command line into words; its marks stay in them."""
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise ValueError(f"{kind} {name}: command {command!r}: {error}; quote its words") from None
    marks = ("{input}", "{reduced}") if kind == "metric" else ("{input}", "{output}")
    if missing := [mark for mark in marks if not any(mark in word for word in words)]:
        must = f"command must hold {' and '.join(marks)}, got {command!r}"
        raise ValueError(f"{kind} {name}: {must}; add {missing[0]}")
    return words


@contextlib.contextmanager
def _on_path(*folders: Path | None) -> Iterator[None]:
    """Let modules of the lab be found, after all others, so that they hide none."""
    places = [str(one) for one in (*folders, Path.cwd()) if one is not None]
    added = [one for one in places if one not in sys.path]
    sys.path.extend(added)
    try:
        yield
    finally:
        for one in added:
            with contextlib.suppress(ValueError):
                sys.path.remove(one)


@lru_cache(maxsize=256)
def _load(method: Method, folder: Path | None) -> Any:  # noqa: ANN401 - whatever the lab wrote
    where, _, name = method.place.rpartition(":")
    if method.origin == "file":
        path = (folder or Path()) / where
        module = call(method, _run_file, path, folder, doing="cannot be loaded")
    else:
        with _on_path(folder):
            module = call(method, importlib.import_module, where, doing="cannot be loaded")
    if _digest_place(method.kind, method.place, folder)[1] != method.sha256:
        said = "was changed in the meantime, or is other code on this machine"
        raise ValueError(f"{method}: {where} {said}; run the command again")
    if not hasattr(module, name):
        what = f"{where} defines no {name!r}"
        raise ValueError(f"{method}: {what}; check the name in {method.place!r}")
    made = getattr(module, name)
    return call(method, made, doing="cannot be made") if inspect.isclass(made) else made


def _run_file(path: Path, folder: Path | None) -> types.ModuleType:
    """Run a file of a study as a module of its own; what it imports from its folder is not kept for other studies."""
    unique = hashlib.sha256(str(path).encode()).hexdigest()[:8]
    module = types.ModuleType(f"feel321_study_{unique}_{path.stem}")
    module.__file__ = str(path)
    before = set(sys.modules)
    sys.modules[module.__name__] = module
    try:  # without bytecode, which would be that of a file of equal size written in the same second
        with _on_path(path.parent, folder):
            exec(compile(path.read_bytes(), path, "exec"), vars(module))  # noqa: S102 - what it is for
    finally:
        for name in set(sys.modules) - before - {module.__name__}:
            source = getattr(sys.modules[name], "__file__", None)
            if source and Path(source).resolve().is_relative_to(path.parent):
                del sys.modules[name]
    return module


def call(method: Method, function: Callable[..., Any], *args: Any, doing: str = "") -> Any:  # noqa: ANN401 - whatever the lab takes and gives
    """Call a lab's code: what it prints goes to stderr, and a failure becomes one line, with `doing`, what failed."""
    near = _find_roots(method) if method.origin == "file" else []
    with (
        _TURN,
        _on_path(*near),
        Path(os.devnull).open("w", encoding="utf-8") as nowhere,
        contextlib.redirect_stdout(sys.stderr or nowhere),  # which may be closed
        warnings.catch_warnings(record=True) as noticed,
    ):
        warnings.simplefilter("default")
        try:
            return function(*args)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # sys.exit, too little memory, recursion: all the same here
            said = f"; {doing}" if doing else ""
            raise ValueError(f"{method}: {_word(error, method)}{said}") from error
        finally:
            for one in noticed or ():
                _say_once(f"{method}: {one.category.__name__}: {one.message}")


@lru_cache(maxsize=1024)
def _say_once(text: str) -> None:
    if sys.stderr is not None:
        sys.stderr.write(f"feel321: warning: {clip(' '.join(text.split()), LONGEST_REASON)}\n")


def _word(error: BaseException, method: Method) -> str:
    """Word a lab's error: its class, its message, and the line of the lab's code."""
    reason = ""
    with contextlib.suppress(Exception):  # the text of an error may be an error too
        said = str(error.msg if isinstance(error, SyntaxError) else error)
        reason = clip(" ".join(said.split()), LONGEST_REASON)
    if isinstance(error, SystemExit):
        reason = f"it called sys.exit({reason}), a method must return"
    roots = _find_roots(method)
    frames = [(one.filename, one.lineno) for one in traceback.extract_tb(error.__traceback__)]
    own = [at for at in frames if any(Path(at[0]).is_relative_to(root) for root in roots)]
    own += [(error.filename or "", error.lineno)] if isinstance(error, SyntaxError) else []
    file, line = own[-1] if own else ("", 0)
    place = f" ({'/'.join(Path(file).parts[-2:])}, line {line})" if file else ""
    kind = "SyntaxError" if isinstance(error, SyntaxError) else type(error).__name__
    return f"{kind}{': ' if reason else ''}{reason}{place}"


def _find_roots(method: Method) -> list[Path]:
    """Find the folder, the file or the package that holds the lab's code."""
    where = method.place.rpartition(":")[0]
    if method.origin == "file":
        return [((method.folder or Path()) / where).parent]
    if method.origin == "function":
        code = getattr(method.function, "__code__", None)
        return [Path(getattr(code, "co_filename", "<function>"))]
    top = sys.modules.get(where.partition(".")[0])
    places = [*getattr(top, "__path__", ()), getattr(top, "__file__", None)]
    return [Path(place) for place in places if place]
