"""One attempt at a trial as its records tell it: what was felt, what was answered, what was wrong."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from protocols.registry import PROTOCOLS
from protocols.trial import RATING_RANGE

if TYPE_CHECKING:
    from collections.abc import Mapping

    from protocols.flow import Flow
    from protocols.trial import Trial

_PLAYBACK: dict[str, type | tuple[type, ...]] = {
    "requested_s": (float, int),
    "onset_s": (float, int, type(None)),
    "underruns": int,
    "clipped": int,
    "completed": bool,
    "error": str,
}
"""What a playback tells, and of which type."""

_ENDS_UNANSWERED = frozenset({"device_error", "not_felt"})


@dataclass(slots=True)
class Attempt:
    """What the journal says of an attempt so far.

    Parameters
    ----------
    trial : Trial
        The trial.
    number : int
        Which attempt at it.
    playbacks : dict of str to mapping
        What became last of each part that was felt; what was cut short replaces nothing that was felt to its end.
    """

    trial: Trial
    number: int
    playbacks: dict[str, Mapping[str, Any]] = field(default_factory=dict)

    def take(self, event: str, data: Mapping[str, Any]) -> None:
        """Take a part as played, or as prompted where it is the real surface.

        Parameters
        ----------
        event : str
            `played` or `prompted`.
        data : mapping
            What became of it.

        Raises
        ------
        ValueError
            If the trial has no such part, or nothing of that kind is felt there.
        """
        part = next((part for part in self.trial.parts if part.name == data["part"]), None)
        if part is None or event != ("prompted" if part.stimulus_id is None else "played"):
            raise ValueError(f"{event} part {data['part']!r}, which trial {self.trial.number} has not")
        for name, kind in _PLAYBACK.items():
            if not isinstance(data[name], kind):
                raise TypeError(f"{name} {data[name]!r}")
        before = self.playbacks.get(part.name)
        if before is None or not before["completed"] or data["completed"] or data["error"]:
            self.playbacks[part.name] = data

    def check_rated(self, data: Mapping[str, Any], flow: Flow) -> None:
        """Check that an answer could be taken, and that it counts as the rules say.

        Parameters
        ----------
        data : mapping
            The answer.
        flow : Flow
            The rules of the session.

        Raises
        ------
        ValueError
            If a part was not felt, a value is not allowed, or flags or rejection do not follow.
        """
        if unfelt := self._list_unfelt():
            raise ValueError(f"rates trial {self.trial.number}, of which {', '.join(unfelt)} was not felt to its end")
        self._check_values(data["values"])
        flags = self._list_flags()
        if data["response_time_s"] < flow.min_response_s:
            flags.append("too_fast")
        self._check_flags(data, flags)
        rejected = not set(flow.reject).isdisjoint(flags)
        if data["rejected"] is not rejected:
            raise ValueError(f"has rejected {data['rejected']!r}, the rules of the plan say {rejected}")

    def check_spoiled(self, data: Mapping[str, Any]) -> None:
        """Check that an attempt had to end without an answer.

        Parameters
        ----------
        data : mapping
            How it ended.

        Raises
        ------
        ValueError
            If it had not, or its flags do not follow from what was felt.
        """
        flags = self._list_flags()
        if self.trial.timing == "strict" and self._list_unfelt():
            flags.append("not_felt")
        if _ENDS_UNANSWERED.isdisjoint(flags):
            raise ValueError(f"spoils trial {self.trial.number}, with which nothing was wrong")
        self._check_flags(data, flags)

    def _list_unfelt(self) -> list[str]:
        felt = {name for name, data in self.playbacks.items() if data["completed"] and not data["error"]}
        return [part.name for part in self.trial.parts if part.name not in felt]

    def _list_flags(self) -> list[str]:
        fields = {"underrun": "underruns", "clipped": "clipped", "device_error": "error"}
        return [flag for flag, name in fields.items() if any(data[name] for data in self.playbacks.values())]

    def _check_values(self, values: Mapping[str, Any]) -> None:
        judged = [judgement.part for judgement in self.trial.judgements]
        if sorted(values) != sorted(judged):
            got, asked = (", ".join(names) or "nothing" for names in (values, judged))
            raise ValueError(f"rates {got}, trial {self.trial.number} asks for {asked}")
        choices = PROTOCOLS[self.trial.protocol].choices
        low, high = RATING_RANGE
        for part, value in values.items():
            if value not in choices if choices else not (isinstance(value, float) and low <= value <= high):
                allowed = ", ".join(choices) or f"{low:g} to {high:g} points"
                raise ValueError(f"has {value!r} for {part}, allowed: {allowed}")

    def _check_flags(self, data: Mapping[str, Any], flags: list[str]) -> None:
        if sorted(data["flags"]) != sorted(flags):
            raise ValueError(f"has flags {data['flags']}, by what was felt and answered they are {flags}")
