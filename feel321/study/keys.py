"""The keys of a session. A key does the same in every task; a lab's own keys stand in `[keys]` of `rig.toml`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from string import ascii_lowercase, digits
from typing import Annotated, Self

from pydantic import AfterValidator, BeforeValidator, model_validator

from feel321.study.settings import fields

KEY_NAMES = (  # names of keys, the same on the main block and on the number block
    *ascii_lowercase,
    *digits,
    *(f"f{number}" for number in range(1, 25)),
    *("enter", "space", "escape", "tab", "backspace", "insert", "delete", "home", "end"),
    *("left", "right", "up", "down", "pageup", "pagedown", "comma", "period", "minus", "plus"),
    *("equal", "slash", "backslash", "semicolon", "apostrophe", "grave"),
)

SIGNS = {"left": "←", "right": "→", "up": "↑", "down": "↓", "pageup": "⇞", "pagedown": "⇟"}
"""What stands on keys that have no word."""

PLAY = "play "  # what the action of each of the keys `play` begins with; a number from 1 follows


def _as_tuple(names: object) -> object:
    listed = [names] if isinstance(names, str) else names
    return tuple(listed) if isinstance(listed, list) else listed


def _check_keys(names: tuple[str, ...]) -> tuple[str, ...]:
    for name in fields.check_some(names):
        if name not in KEY_NAMES:
            near = get_close_matches(name.lower(), KEY_NAMES, n=1)
            hint = f"did you mean {near[0]!r}?" if near else "press it in a text editor to see it"
            allowed = "a letter, a digit, f1 to f24 or a name such as enter, space, pageup, comma"
            raise ValueError(f"must be keys, {allowed}; {hint}")
    return names


Keys = Annotated[tuple[str, ...], BeforeValidator(_as_tuple), AfterValidator(_check_keys)]


class KeysTable(fields.TomlTable):
    """`[keys]`: which key does what: one key, or several that do the same; the screen names the first."""

    next: Keys = ("enter",)
    experimenter: Keys = ("f12",)
    stop: Keys = ("space",)
    pause: Keys = ("escape",)
    again: Keys = ("r",)
    loop: Keys = ("l",)
    reference: Keys = ("tab",)
    play: Keys = tuple(f"f{number}" for number in range(1, 10))
    left: Keys = ("left",)
    right: Keys = ("right",)
    more: Keys = ("pageup",)
    less: Keys = ("pagedown",)
    up: Keys = ("up",)
    down: Keys = ("down",)
    type_values: bool = True

    @model_validator(mode="after")
    def _do_one_thing_each(self) -> Self:
        uses: dict[str, str] = {}
        for key, action in self.list_uses():
            if (other := uses.setdefault(key, action)) != action:
                both = f"got {key!r} for {other} and {action}"
                raise ValueError(f"{both}, but a key does one thing; change one of them")
        return self

    def list_uses(self) -> Iterator[tuple[str, str]]:
        """List every key with its action."""
        for action, keys in self:
            listed = digits * keys if action == "type_values" else keys
            for number, key in enumerate(listed, start=1):
                yield key, f"{PLAY}{number}" if action == "play" else action

    def name_action(self, key: str) -> str:
        """Name what a key does; empty if nothing."""
        return dict(self.list_uses()).get(key, "")

    def find_key(self, action: str) -> str:
        """Find the first key of an action; empty if there is none."""
        return next((key for key, own in self.list_uses() if own == action), "")


ACTIONS: Mapping[
    str, tuple[str, ...]
] = {  # the actions that a line of a language's `keys` is about
    "move": ("left", "right"),
    "coarse_rows": ("more", "less"),
    "choose": ("up", "down"),
    "pick": ("left", "right"),
    "confirm": ("next",),
    "again": ("again",),
    "stop": ("stop",),
    "pause": ("pause",),
    "leave": ("pause",),
}

USUAL = KeysTable()


def label_texts(
    keys: KeysTable, lines: Mapping[str, str], prompts: Mapping[str, str]
) -> tuple[dict[str, str], dict[str, str]]:
    """Put a lab's own keys into the lines of a language (a key, two spaces, what it does), and into its prompts."""
    enter, space, escape = (lines[line].partition("  ")[0] for line in ("confirm", "stop", "pause"))
    words = {"enter": enter, "space": space, "escape": escape.partition(" ")[0]}
    labelled, said = dict(lines), dict(prompts)
    for line, actions in ACTIONS.items():
        before, _, does = lines[line].partition("  ")
        own = [keys.find_key(action) for action in actions]
        if own != [USUAL.find_key(action) for action in actions]:
            twice = before.partition(" ")[2] if actions == ("pause",) else ""
            labels = " ".join(filter(None, [*(label_key(key, words) for key in own), twice]))
            labelled[line] = f"{labels}  {does}"
    ends = dict.fromkeys(label_key(key, words) for key in (keys.play[0], keys.play[-1]))
    feel = f"{label_key(keys.reference[0], words)} {'–'.join(ends)}"
    labelled["feel"] = f"{feel}  {lines['feel'].partition('  ')[2]}"
    for action in ("next", "pause", "experimenter"):
        usual, now = (label_key(one.find_key(action), words) for one in (USUAL, keys))
        said = {name: text.replace(usual, now) for name, text in said.items()}
    return labelled, said


def label_key(key: str, words: Mapping[str, str]) -> str:
    """Name a key as it stands on it; words: of a language, by key."""
    return words.get(key) or SIGNS.get(key) or key.capitalize()
