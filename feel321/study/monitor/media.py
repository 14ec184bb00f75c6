"""Screens as SVG and vibrations as sound, for pages that need no file beside them."""

from __future__ import annotations

import base64
import io
import wave
from collections.abc import Iterable
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from feel321.stimuli.wav import read_wav
from feel321.study.actuator.tone import make_tone
from feel321.study.screen import drawing
from feel321.study.session.ports import Scaled, Tone

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from feel321.stimuli.sets.manifest import Stimulus

SOUND_HZ = 8000
"""Sampling rate of sounds, in Hz: vibrations end at 1000 Hz."""

PICTURE_TYPES = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg", ".gif": "gif", ".webp": "webp"}


def write_svg(item: drawing.Item) -> str:
    """Write one item of a sheet as SVG."""
    box = item.box
    if isinstance(item, drawing.Text):
        return _write_text(item)
    place = (
        f'x="{box.left:.1f}" y="{box.top:.1f}" width="{box.width:.1f}" height="{box.height:.1f}"'
    )
    if isinstance(item, drawing.Photo):
        kind = PICTURE_TYPES.get(item.path.suffix.lower(), "png")
        data = base64.b64encode(item.path.read_bytes()).decode()
        return f'<image {place} href="data:image/{kind};base64,{data}"/>'
    if item.line:
        inner = box.grow(-item.line_px / 2)
        place = f'x="{inner.left:.1f}" y="{inner.top:.1f}" width="{inner.width:.1f}" height="{inner.height:.1f}"'
    line = f' stroke="{item.line}" stroke-width="{item.line_px:.1f}"' if item.line else ""
    return f'<rect {place} rx="{item.round_px:.1f}" fill="{item.fill or "none"}"{line}/>'


def _write_text(text: drawing.Text) -> str:
    """Write a line of text, as wide as the layout takes it to be whatever font there is."""
    box, words = text.box, text.words
    x = {"left": box.left, "right": box.right}.get(text.align, box.left + box.width / 2)
    anchor = {"left": "start", "right": "end"}.get(text.align, "middle")
    y = box.top + box.height / 2 + 0.36 * text.size
    width = drawing.measure(words, text.size, bold=text.bold) / drawing.SLACK
    bold = ' font-weight="bold"' if text.bold else ""
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" font-size="{text.size:.1f}" fill="{text.color}" text-anchor="{anchor}" '
        f'textLength="{width:.1f}" lengthAdjust="spacingAndGlyphs"{bold}>{escape(words)}</text>'
    )


def read_words(items: Iterable[drawing.Item]) -> str:
    """Read what is written on a sheet, in order."""
    return "; ".join(item.words for item in items if isinstance(item, drawing.Text))


@dataclass(slots=True)
class SoundBank:
    """Sounds of vibrations, each once, by key; folder: that of the stimulus set."""

    folder: Path
    full_scale_m_s2: float
    sounds: dict[str, str] = field(default_factory=dict)
    _peaks: dict[str, float] = field(default_factory=dict)

    def add(self, heard: Stimulus | Tone | Scaled) -> tuple[str, float] | None:
        """Add what is felt; returns its key and its peak, None for silence and where the file is gone."""
        if isinstance(heard, Tone):
            if not heard.scale:
                return None
            key, gain = (
                f"{heard.stimulus_id} {heard.duration_s}",
                heard.scale / self.full_scale_m_s2,
            )
            if key not in self.sounds:
                self._keep(
                    key,
                    make_tone(heard.frequency_hz, duration_s=heard.duration_s, rate_hz=SOUND_HZ),
                )
            return key, gain * self._peaks[key]
        stimulus, gain = (
            (heard.stimulus, heard.scale) if isinstance(heard, Scaled) else (heard, 1.0)
        )
        if (key := stimulus.stimulus_id) not in self.sounds:
            path = self.folder / stimulus.file
            if not path.is_file():
                return None
            self._keep(key, _read_sound(path))
        return key, gain * self._peaks[key]

    def _keep(self, key: str, samples: NDArray[np.float64]) -> None:
        """Keep a sound at full scale, and how strong it was."""
        self._peaks[key] = peak = float(np.max(np.abs(samples), initial=0.0)) or 1.0
        self.sounds[key] = _write_sound(samples / peak)


def _read_sound(path: Path) -> NDArray[np.float64]:
    """Read a stimulus as one channel: of three axes the strongest, for axes do not add to what is felt."""
    import soxr

    samples, rate_hz = read_wav(path)
    tracks = np.atleast_2d(np.asarray(samples, dtype=np.float64))
    strongest = tracks[int(np.argmax(np.sum(tracks**2, axis=1)))]
    return np.asarray(soxr.resample(strongest, rate_hz, SOUND_HZ), dtype=np.float64)


def _write_sound(samples: NDArray[np.float64]) -> str:
    content = io.BytesIO()
    with wave.open(content, "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(SOUND_HZ)
        file.writeframes(np.round(np.clip(samples, -1, 1) * 32767).astype("<i2").tobytes())
    return base64.b64encode(content.getvalue()).decode()
