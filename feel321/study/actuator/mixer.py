"""The mixer: stimuli, masking noise and limits, block by block, for the stream's callback.

A stimulus that was asked for is scheduled when the next block is filled, so its onset is known to the sample. Filling a
block allocates nothing that lasts. Samples within the limits pass bit for bit; others are changed one by one, so that
the outcome does not depend on how the stream is cut into blocks.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from feel321.study.actuator.rig import Rig
from feel321.types import Samples

Frames = NDArray[np.float32]  # what is played: (n, channels), or (n,) of one channel
Sounds = Mapping[str, Frames]

WINDOW_S = 1.0  # over how long the RMS is taken
PAUSE_S = 0.1  # rest of an actuator after which its duration is counted from 0 again
ROUNDING = 1e-9  # by which a window may exceed its energy: the rounding of sums of squares


class Limiter:
    """The last line of defence for skin and coil: limits peak, RMS of any second, and duration for one actuator."""

    def __init__(
        self, rate_hz: float, *, peak: float, rms: float, duration_s: float, max_frames: int
    ) -> None:
        self._window, self._pause = round(WINDOW_S * rate_hz), round(PAUSE_S * rate_hz)
        self._peak = np.float32(min(peak, 1.0))
        self._energy_limit = float(rms) ** 2 * self._window * (1 + ROUNDING)
        self._longest = round(duration_s * rate_hz)
        self._squares = np.zeros(self._window)  # of the last second, a ring
        self._place = 0
        # Energy of the last second had nothing been limited since the ring began anew, and what was taken from it.
        self._walk = self._excess = 0.0
        # Frames since the last one that was not 0, and since the last pause.
        self._rest, self._run = self._pause, 0
        self._new, self._sums = np.empty((2, max_frames))
        self._given = np.empty(max_frames, dtype=np.float32)
        self._differs = np.empty(max_frames, dtype=np.bool_)

    def limit(self, samples: Frames) -> int:
        """Limit the next block, shape (n,), in place; returns the number of samples that were changed."""
        given, differs = self._given[: len(samples)], self._differs[: len(samples)]
        np.copyto(given, samples)
        # NaN passes every comparison, and a single one blinds the sum of squares to all that follows.
        np.isnan(samples, out=differs)
        np.copyto(samples, 0, where=differs)
        self._limit_duration(samples)
        np.clip(samples, -self._peak, self._peak, out=samples)
        start = 0
        while start < len(samples):  # in pieces that do not wrap around the ring
            piece = samples[start : start + self._window - self._place]
            self._limit_energy(piece)
            start += len(piece)
        np.not_equal(samples, given, out=differs)
        return int(np.count_nonzero(differs))

    def _limit_duration(self, samples: Frames) -> None:
        n = len(samples)
        moving = self._differs[:n]
        np.not_equal(samples, 0, out=moving)
        first = int(moving.argmax()) if n else 0
        if n == 0 or not moving[first]:
            self._rest += n
            self._run += n
            return
        if self._rest + first >= self._pause:
            self._run = -first
        self._rest = int(moving[::-1].argmax())
        allowed = max(self._longest - self._run, 0)
        self._run += n
        samples[allowed:] = 0

    def _limit_energy(self, samples: Frames) -> None:
        """Give each sample what the last second leaves of the energy.

        The energy of the last second is a walk E(i) = min(E(i-1) + d(i), limit), d being what is new less what is a
        second old. That is the free walk S less the running maximum of what S exceeds the limit by (Lindley 1952,
        doi:10.1017/S0305004100027638); each rise of the maximum is taken from the sample where it happens.
        """
        n = len(samples)
        new, sums, old = self._new[:n], self._sums[:n], self._squares[self._place : self._place + n]
        np.copyto(new, samples)  # first, or the product would be made by way of a buffer
        np.multiply(new, new, out=new)
        np.subtract(new, old, out=sums)
        sums[0] += self._walk
        np.cumsum(sums, out=sums)
        self._walk = float(sums[-1])
        if sums.max() - self._energy_limit > self._excess:
            above = np.maximum(sums - self._energy_limit, self._excess)
            rises = np.diff(np.maximum.accumulate(above), prepend=self._excess)
            self._excess = float(above.max())
            np.maximum(new - rises, 0, out=new)
            limited = np.copysign(np.sqrt(new).astype(np.float32), samples)
            np.copyto(samples, limited, where=rises > 0)
        np.copyto(old, new)
        self._place += n
        # Once per round the sum is taken afresh, or its rounding would grow for hours.
        if self._place == self._window:
            self._place, self._walk, self._excess = 0, float(self._squares.sum()), 0.0


LOOP_S = 20.0  # how long the noise is before it repeats: too long for a repetition to be heard
LOWEST_HZ = 20.0  # below this nothing is heard
NEVER = 2**62  # a frame that no stream reaches


def make_pink(rng: np.random.Generator, *, n_samples: int, rate_hz: float) -> Samples:
    """Make Gaussian noise, shape (n_samples,), whose power falls by 10 dB per decade from 20 Hz to half the rate.

    It consists of whole periods, so that it repeats without a click (Timmer and König 1995, Astronomy and Astrophysics
    300, 707-710).
    """
    frequencies = np.fft.rfftfreq(n_samples, 1 / rate_hz)
    audible = frequencies >= LOWEST_HZ
    spectrum = np.zeros(len(frequencies), dtype=np.complex128)
    parts = rng.standard_normal((2, int(audible.sum())))
    spectrum[audible] = (parts[0] + 1j * parts[1]) / np.sqrt(frequencies[audible])
    noise = np.fft.irfft(spectrum, n_samples)
    return np.asarray(noise / np.sqrt(np.mean(noise**2)))


class Masker:
    """Noise on headphones (columns, from 0) that begins before a vibration and ends after it, in ramps."""

    def __init__(
        self,
        noise: Frames,
        *,
        columns: list[int],
        ramp_frames: int,
        lead_frames: int,
        max_frames: int,
    ) -> None:
        self._noise, self._columns, self._lead = noise, columns, lead_frames
        # Half a cosine has no audible edge; it ends at exactly 1.
        self._top = max(ramp_frames, 1)
        steps = np.arange(self._top + 1) / self._top
        self._ramp = (0.5 - 0.5 * np.cos(np.pi * steps)).astype(np.float32)
        self._block, self._gain = np.zeros((2, max_frames), dtype=np.float32)
        self._counts = np.arange(1, max_frames + 1)
        self._steps = np.zeros(max_frames, dtype=np.intp)
        self.silence()

    def silence(self) -> None:
        """Be silent at once, for a stream that begins anew, and forget what was scheduled."""
        self._step, self._is_up = 0, False  # how far up the ramp, and where it is going
        self._up_at = self._down_at = NEVER

    def cover(self, frame: int, gap_frames: int) -> int:
        """Find the onset of a vibration, gap_frames from here at least, that the noise can precede, and schedule it."""
        is_heard = self._is_up and self._step == self._top and self._down_at > frame
        onset = frame + (gap_frames if is_heard else max(gap_frames, self._lead))
        begin = onset - self._lead
        if self._is_up and begin <= self._down_at:
            self._down_at = NEVER
        else:
            self._up_at = begin
        return onset

    def release(self, end: int) -> None:
        """Schedule the end of the noise, after a vibration."""
        if self._up_at >= end:  # it never began, and must not begin now
            self._up_at = NEVER
        is_heard = self._is_up or self._up_at < NEVER
        self._down_at = max(end + self._lead - self._top, end) if is_heard else NEVER

    def fill(self, block: Frames, frame: int) -> None:
        """Write the noise into the headphones' channels of the next block, shape (n, channels)."""
        n = len(block)
        if not self._is_up and self._step == 0 and self._up_at >= frame + n:
            return
        gain, noise, start = self._gain[:n], self._block[:n], frame % len(self._noise)
        place = 0
        while place < n:
            now = frame + place
            if now >= self._up_at:
                self._is_up, self._up_at = True, NEVER
            if now >= self._down_at:
                self._is_up, self._down_at = False, NEVER
            piece = gain[place : place + min(self._up_at, self._down_at) - now]
            steps = self._steps[: len(piece)]
            np.multiply(self._counts[: len(piece)], 1 if self._is_up else -1, out=steps)
            np.add(steps, self._step, out=steps)
            np.take(self._ramp, steps, out=piece, mode="clip")
            self._step = min(max(int(steps[-1]), 0), self._top)
            place += len(piece)
        whole = min(n, len(self._noise) - start)
        noise[:whole] = self._noise[start : start + whole]
        noise[whole:] = self._noise[: n - whole]
        np.multiply(noise, gain, out=noise)
        for column in self._columns:
            block[:, column] = noise


BLOCK_FRAMES = 1024  # longer blocks are filled in pieces of this many frames
PREROLL_S = 0.25  # silence before anything is scheduled: devices swallow what comes first
STOP_S = 0.005  # fade of a stopped vibration, at most a block: cut off at once it would knock
NOT_SCHEDULED = -1


@dataclass(slots=True)
class Cue:
    """One playback, from its request to its end; the callback writes it, everybody may read it.

    sound: (n_samples, channels), times `scale`; gap_frames: silence before it, at least; first_frame: 0 for the whole;
    lead_frames: by how much its first sample is sent before the vibration begins.
    """

    sound: Frames = field(default_factory=lambda: np.zeros((0, 1), dtype=np.float32))
    gap_frames: int = 0
    scale: float = 1.0
    first_frame: int = 0
    lead_frames: int = 0
    onset_frame: int = NOT_SCHEDULED
    n_played: int = 0
    clipped: int = 0
    is_stopping: bool = False
    is_over: bool = False

    @property
    def is_at_end(self) -> bool:
        """Whether it was played to its end."""
        return self.n_played == len(self.sound)

    @property
    def is_complete(self) -> bool:
        """Whether every sample of the stimulus was played as it is."""
        return self.is_at_end and not self.first_frame


class Mixer:
    """Mixes the samples of a rig's channels; sounds: (n_samples, channels)."""

    def __init__(
        self, rig: Rig, sounds: Sounds, *, rate_hz: float, preroll_s: float = PREROLL_S
    ) -> None:
        self.frame = 0
        self._rate_hz, self._sounds, self._sync = rate_hz, sounds, rig.sync
        self._preroll = round(preroll_s * rate_hz)
        self._block = min(BLOCK_FRAMES, round(PAUSE_S * rate_hz))  # a pause spans blocks
        limits = rig.limits
        self._limiters = [
            (
                one.channel - 1,
                Limiter(
                    rate_hz,
                    peak=limits.peak_m_s2 / one.full_scale_m_s2,
                    rms=limits.rms_m_s2 / one.full_scale_m_s2,
                    duration_s=limits.duration_s,
                    max_frames=self._block,
                ),
            )
            for one in rig.actuators
        ]
        self._masker: Masker | None = None
        if masking := rig.masking:
            rng = np.random.default_rng(masking.seed)
            noise = make_pink(rng, n_samples=round(LOOP_S * rate_hz), rate_hz=rate_hz)
            self._masker = Masker(
                (masking.rms * noise).astype(np.float32),
                columns=[channel - 1 for channel in masking.channels],
                ramp_frames=round(masking.ramp_s * rate_hz),
                lead_frames=round(masking.lead_s * rate_hz),
                max_frames=self._block,
            )
        self._sync_frames = max(round(rig.sync.duration_s * rate_hz), 1) if rig.sync else 0
        n_fade = max(round(STOP_S * rate_hz), 1)
        self._fade_steps = np.arange(1, n_fade + 1, dtype=np.float32)
        self._fade_gain = np.empty(n_fade, dtype=np.float32)
        self._waiting: deque[Cue] = deque()  # its ends are safe to use from two threads
        self._latest: Cue | None = None
        self._cue: Cue | None = None

    def start(
        self,
        stimulus_id: str,
        *,
        gap_s: float,
        scale: float = 1.0,
        goes_on: bool = False,
        lead_s: float = 0.0,
        cue: Cue | None = None,
    ) -> Cue:
        """Ask for a stimulus, times `scale`; the one that is playing is stopped.

        goes_on: begin where the last one was stopped, which is faded in there as that one was faded out. lead_s: from
        its first sample to the vibration; it is taken from the gap, down to a pause that the limiter counts as one.
        """
        self.stop()
        sound, last = self._sounds[stimulus_id], self._latest
        sound = sound if scale == 1 else sound * np.float32(scale)
        first = (last.first_frame + last.n_played) % len(sound) if goes_on and last else 0
        if first:
            sound = sound[first:].copy()
            n = min(len(sound), len(self._fade_steps))
            sound[:n] *= (self._fade_steps[:n] / np.float32(n))[:, None]
        cue = self._latest = cue or Cue()
        cue.sound, cue.scale, cue.first_frame = sound, scale, first
        cue.gap_frames = round(max(gap_s - lead_s, min(gap_s, PAUSE_S)) * self._rate_hz)
        cue.lead_frames = 0 if first else round(lead_s * self._rate_hz)
        self._waiting.append(cue)
        return cue

    @property
    def is_playing(self) -> bool:
        """Whether samples of the stimulus that was started last, or of its gap, are still to be filled."""
        return self._latest is not None and not self._latest.is_over

    def stop(self) -> None:
        """Fall silent within the next block."""
        if self._latest is not None:
            self._latest.is_stopping = True

    def reset(self) -> None:
        """Forget what plays and waits, for a device that begins anew; skin and coil, and so the limiters, do not."""
        for cue in (self._cue, *self._waiting):
            if cue is not None:
                cue.is_over = True
        self._waiting.clear()
        if self._masker:
            self._masker.silence()

    def fill(self, out: Frames) -> None:
        """Fill the stream's next block, shape (n, channels)."""
        for start in range(0, len(out), self._block):
            self._fill(out[start : start + self._block])

    def _fill(self, block: Frames) -> None:
        block.fill(0)
        cue = self._take()
        end = self._play(cue, block) if cue else None
        if self._masker:
            if end is not None:
                self._masker.release(end)
            self._masker.fill(block, self.frame)
        n_changed = 0
        for column, limiter in self._limiters:  # last, so that nothing gets past them
            n_changed += limiter.limit(block[:, column])
        self.frame += len(block)
        if cue:
            cue.clipped += n_changed
            cue.is_over = end is not None  # last of all: who reads it then reads the rest

    def _take(self) -> Cue | None:
        """Find what plays now; take up what waits if nothing does."""
        if self._cue is not None and not self._cue.is_over:
            return self._cue
        self._cue = None
        while self._cue is None and self._waiting and self.frame >= self._preroll:
            cue = self._waiting.popleft()
            if cue.is_stopping:
                cue.is_over = True
                continue
            cue.onset_frame = self.frame + cue.gap_frames
            if self._masker:
                cue.onset_frame = self._masker.cover(self.frame, cue.gap_frames)
            self._cue = cue
        return self._cue

    def _play(self, cue: Cue, block: Frames) -> int | None:
        """Write a stimulus and its sync pulse into this block; return the frame after its end if it ends here."""
        is_stopping = cue.is_stopping  # read once: another thread sets it
        first = max(cue.onset_frame - self.frame, 0)
        if is_stopping and not cue.n_played:
            cue.onset_frame = NOT_SCHEDULED
            return self.frame
        piece = block[first:]
        piece = piece[: len(cue.sound) - cue.n_played]
        np.copyto(piece, cue.sound[cue.n_played : cue.n_played + len(piece)])
        if self._sync:
            onset = cue.onset_frame + cue.lead_frames - self.frame
            pulse = block[max(onset, 0) : max(onset + self._sync_frames, 0)]
            pulse[:, self._sync.channel - 1] = self._sync.level
        cue.n_played += self._fade(piece) if is_stopping else len(piece)
        return self.frame + first + len(piece) if is_stopping or cue.is_at_end else None

    def _fade(self, piece: Frames) -> int:
        """Fade a vibration out in this piece; returns how many samples are left, the last of the fade being 0."""
        n = min(len(piece), len(self._fade_steps))
        gain = self._fade_gain[:n]
        np.multiply(self._fade_steps[:n], np.float32(-1 / n), out=gain)
        np.add(gain, np.float32(1), out=gain)
        gain[-1:] = 0
        for column, _ in self._limiters:
            np.multiply(piece[:n, column], gain, out=piece[:n, column])
            piece[n:, column] = 0
        return n - 1
