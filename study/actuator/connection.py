"""The connection to a rig's device: opened until it runs steadily, and opened again if the device dies."""

from __future__ import annotations

from threading import Thread
from time import sleep
from typing import TYPE_CHECKING

from study.actuator.devices import check_channels, find_device
from study.actuator.patience import Patience, join
from study.actuator.stream import Line, list_devices, refresh_devices

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from study.actuator.devices import Device
    from study.actuator.rig import Rig
    from study.actuator.stream import Fill
    from study.actuator.take import Block

OPENING_S = 5.0
"""So long a device may take, beyond its pre-roll, until its stream runs; sound servers take two seconds by habit."""

N_OPENINGS = 3
"""A sound server that is busy may let a first stream stand; a later one runs."""

WAKING_S = 1.0
"""So long a stream that nobody looked at, and that was silent for long, may take to ask for a block."""

REVIVING_S = 8.0
"""So long a start waits for a dead device; it may well come back later."""


class Connection:
    """The one line to a device, if there is one.

    Parameters
    ----------
    rig : Rig
        The rig.
    rate_hz : float
        Sampling rate in Hz.
    fill : callable
        Fills the blocks, in a thread of the device's.
    reset : callable
        Called before a new line opens, when no other one asks for blocks.
    preroll_s : float
        So much a new line has to have played before it is trusted, in s.

    Attributes
    ----------
    line : Line or None
        The line.
    """

    def __init__(self, rig: Rig, *, rate_hz: float, fill: Fill, reset: Callable[[], None], preroll_s: float) -> None:
        self.line: Line | None = None
        self._rig = rig
        self._rate_hz = rate_hz
        self._fill = fill
        self._reset = reset
        self._preroll_s = preroll_s
        self._n_frames = 0
        self._opening: Thread | None = None
        self._error = ""

    def open(self) -> None:
        """Find the device, open it, and wait until it runs steadily.

        Raises
        ------
        OSError
            If the device is not there, refuses channels or rate, or does not run.
        """
        device = find_device(list_devices(), self._rig.device.name, host_api=self._rig.device.host_api)
        check_channels(device, self._rig)
        if not any(self._begin(device) for _ in range(N_OPENINGS)):
            raise OSError(f"device: got {device.name!r}, which does not run; is it in use elsewhere?")

    def _begin(self, device: Device) -> bool:
        self._n_frames = 0
        self._reset()
        self.line = Line(device, self._rig, rate_hz=self._rate_hz, fill=self._count)
        patience = Patience()
        while self._n_frames < self._preroll_s * self._rate_hz:
            if not self.line.is_active or patience.look() > OPENING_S + self._preroll_s:
                self.close()
                return False
            sleep(0.005)
        return True

    def revive(self) -> str:
        """Open the device again if it does not run.

        Returns
        -------
        str
            Why it still does not run; empty if it does.
        """
        if self._opening is None and self.line is not None and self._runs(self.line):
            return ""
        if self._opening is None:
            # Looking for devices can hang as long as a sound server does; the session must not.
            self._opening = Thread(target=self._reopen, daemon=True)
            self._opening.start()
        if not join(self._opening, patience_s=REVIVING_S):
            return f"device: got {self._rig.device.name!r}, which does not answer; see to it, then go on"
        self._opening = None
        return self._error

    @staticmethod
    def _runs(line: Line) -> bool:
        patience = Patience()
        while not line.find_fault():
            if not line.is_silent:
                return True
            if patience.look() > WAKING_S:
                return False
            sleep(0.005)
        return False

    def close(self) -> None:
        """Silence the device and let it go."""
        if self.line is not None:
            self.line.close()
        self.line = None

    def _reopen(self) -> None:
        self._error = ""
        self.close()
        try:
            refresh_devices()
            self.open()
        except OSError as problem:
            self._error = str(problem)

    def _count(self, out: NDArray[np.float32], block: Block, sensed: NDArray[np.float32] | None) -> None:
        self._fill(out, block, sensed)
        self._n_frames += len(out)
