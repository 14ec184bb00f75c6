"""Arguments of public functions: paths, randomness, names, progress, and how wrong ones are refused."""

from __future__ import annotations

import difflib
import importlib
import json
import math
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Any, NoReturn, SupportsFloat, TypeVar

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray


TICK_S = 1.0  # between two looks of a progress bar at the clock


def as_path(path: str | os.PathLike[str], what: str = "path") -> Path:
    """Make a path of a str or any other path."""
    if not isinstance(path, str | os.PathLike):
        raise TypeError(f"{what} must be a path, got {describe(path)}")
    return Path(path)


def as_rng(rng: int | np.random.Generator, what: str = "rng") -> np.random.Generator:
    """Make a generator of a seed, or take the generator that is given."""
    import numpy as np  # not before it is needed: the command line answers at once

    if isinstance(rng, np.random.Generator):
        return rng
    if isinstance(rng, bool) or not isinstance(rng, int | np.integer) or rng < 0:
        wanted = "a whole number from 0 or a numpy Generator"
        raise TypeError(f"{what} must be {wanted}, got {describe(rng)}")
    return np.random.default_rng(int(rng))


def as_seed(rng: int | np.random.Generator) -> int:
    """Take the seed that is given, or draw one from a generator."""
    import numpy as np

    generator = as_rng(rng)
    return int(generator.integers(2**32) if isinstance(rng, np.random.Generator) else rng)


@contextmanager
def follow(
    progress: bool | Callable[[int, int], None],  # noqa: FBT001 - a bar, or a function of one's own
    what: str,
) -> Iterator[Callable[[int, int], None]]:
    """Give the function to be called with the numbers of steps done and to do: the caller's, a bar's, or nobody's."""
    if callable(progress):
        yield progress
        return
    if not progress:
        yield lambda _done, _total: None
        return
    from tqdm import tqdm

    over = Event()
    with tqdm(desc=what, leave=False, bar_format="{desc}: {elapsed}") as bar:

        def move(done: int, total: int) -> None:
            bar.bar_format = "{desc}: {n_fmt}/{total_fmt} |{bar:20}| {elapsed}<{remaining}"
            bar.total = total
            bar.update(done - bar.n)

        def tick() -> None:
            while not over.wait(TICK_S):  # the clock runs while a step takes long
                bar.refresh()

        ticking = Thread(target=tick, daemon=True)
        ticking.start()
        try:
            yield move
        finally:
            over.set()
            ticking.join()


def as_names(names: Iterable[str], what: str) -> tuple[str, ...]:
    """Make a tuple of names; a bare str, whose letters would pass for names, is refused."""
    if isinstance(names, str):
        got = f"the text {names!r}; write [{names!r}]"
        raise TypeError(f"{what} must be a list of names, got {got}")
    return tuple(names)


def check_name(name: str, names: Collection[str], what: str) -> str:
    """Return a name that is one of several, or refuse it and list them."""
    if isinstance(name, str) and name in names:
        return name
    raise ValueError(refuse_name(name, names, what))


def refuse_name(name: object, names: Collection[str], what: str) -> str:
    """Word the refusal of a name that is not one of several."""
    near = difflib.get_close_matches(str(name), list(names), n=1)
    hint = f", did you mean {near[0]!r}?" if near else ""
    return f"{what} must be one of {', '.join(names)}; got {describe(name)}{hint}"


def clean_text(text: str, *, keep: str = "") -> str:
    """Spell out, as JSON does, what a terminal would obey and a reader not see: control and format characters."""
    spelt = {c: json.dumps(c)[1:-1].replace("\x7f", "\\u007f") for c in {*text} - {*keep}}
    return "".join(c if c.isprintable() else spelt.get(c, c) for c in text)


def describe(value: object) -> str:
    """Describe what was got in a few words: the value if it is short, else its type."""
    shape = getattr(value, "shape", None)
    if shape is not None:
        return f"{type(value).__name__} of shape {shape}"
    text = repr(value)
    fits = len(text) <= 60 and "\n" not in text  # noqa: PLR2004 - characters of one line's message
    return text if fits else f"a {type(value).__name__}"


def coerce_real(values: ArrayLike, what: str) -> NDArray[np.float64]:
    """Coerce real numbers to float64, or say what they are instead."""
    import numpy as np

    try:
        given = np.asarray(values)
    except ValueError as error:
        must = f"{what} must be one array"
        raise ValueError(f"{must}, got rows of unequal lengths ({error})") from None
    if given.dtype.kind not in "biuf":
        raise ValueError(f"{what} must be real numbers, got values of type {given.dtype}")
    if np.ma.is_masked(values):
        raise ValueError(f"{what} must not be masked; fill the masked values or cut them out first")
    return given.astype(np.float64, copy=False)


def check_finite(samples: NDArray[np.float64], what: str) -> None:
    """Raise ValueError that counts and places the values that are not finite."""
    import numpy as np

    # A finite sum proves that all are finite, in one pass; an infinite one may only be an overflow.
    with np.errstate(over="ignore", invalid="ignore"):
        if np.isfinite(samples.sum()):
            return
    bad = np.argwhere(~np.isfinite(samples))
    if len(bad):
        place = ", ".join(str(i) for i in bad[0])
        must = f"{what} must be finite, got {len(bad)} values that are not (first at {place})"
        raise ValueError(f"{must}; remove or correct them")


def check_rate(rate_hz: SupportsFloat | str, what: str = "rate_hz", unit: str = " of Hz") -> float:
    """Return a rate, or any other quantity above 0, as float, or say what is wrong."""
    try:
        rate = float(rate_hz)
    except (OverflowError, TypeError, ValueError):
        rate = float("nan")
    if not (math.isfinite(rate) and rate > 0):
        raise ValueError(f"{what} must be a finite number{unit} above 0, got {describe(rate_hz)}")
    return rate


Entry = TypeVar("Entry")


class Registry(dict[str, Entry]):
    """An ordered mapping of names; a wrong name lists the right ones."""

    def __init__(
        self,
        what: str,
        entries: Mapping[str, Entry],
        *,
        find: Callable[[str, Collection[str]], Entry] | None = None,
    ) -> None:
        """Take the entries, and how to find one that a lab adds, from what it is given as and the names taken."""
        super().__init__(entries)
        self._what, self._find = what, find

    def __missing__(self, name: str) -> NoReturn:
        """Refuse a name."""
        raise KeyError(refuse_name(name, self, self._what))

    def __repr__(self) -> str:
        """List the names."""
        return f"<{self._what}: {', '.join(self)}>"

    def find(self, given: str | Entry) -> Entry:
        """Return the entry of a name, one that a lab adds, or what is given itself."""
        if not isinstance(given, str):
            return given
        if given in self:
            return self[given]
        if self._find is None:
            raise ValueError(refuse_name(given, self, self._what))
        return self._find(given, self)

    def choose(self, wanted: str | Entry | Iterable[str | Entry] = "all") -> dict[str, Entry]:
        """Return several entries by name, as wanted: "all", a list of what `find` takes, one entry, or a mapping."""
        if isinstance(wanted, str):
            return (
                dict(self) if wanted == "all" else self.choose(as_names(wanted, f"{self._what}s"))
            )
        if isinstance(wanted, Mapping):
            return {name: self.find(one) for name, one in wanted.items()}
        several = [*wanted] if isinstance(wanted, Iterable) else [wanted]
        chosen = {name_of(one): self.find(one) for one in several}
        if len(chosen) < len(several):
            got = f"got {', '.join(map(name_of, several))}; name them: {{'mine': f}}"
            raise ValueError(f"{self._what}s must have names that differ, {got}")
        return chosen


def name_of(method: object) -> str:
    """Name a method of a registry: the name it was given by, without its place, or that of its function."""
    if isinstance(method, str):
        return method.rpartition(":")[2]
    return getattr(method, "__name__", repr(method))


def import_lazily(face: str, path: str) -> Callable[[str], Any]:
    """Make a face's `__getattr__`: what it imports for type checkers only is imported when it is asked for."""
    import ast

    tree = ast.parse(Path(path).read_text(encoding="utf-8"))
    nodes = [node for branch in tree.body if isinstance(branch, ast.If) for node in branch.body]
    imports = [node for node in nodes if isinstance(node, ast.ImportFrom)]
    places = {alias.name: str(node.module) for node in imports for alias in node.names}

    def find(name: str) -> Any:  # noqa: ANN401 - whatever the name stands for
        if name not in places:
            raise AttributeError(f"module {face!r} has no attribute {name!r}")
        return getattr(importlib.import_module(places[name]), name)

    return find
