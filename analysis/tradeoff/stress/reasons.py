"""Why a reducer fails by a measure: the explanation that a red cell leads to."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

_SILENT = "it keeps one sensor axis; where that is (nearly) silent, the output is nothing but noise."
_CHANCE = "no direction leads, so the noise of the moment chooses the axis, and with it a different motion."
_SUM_PHASE = "the phase is that of x + y + z; where the axes cancel, noise sets it."
_OWN_AXIS = "what it keeps depends on where the sensor's own axes point."
_DIAGONAL = "x + y + z is the projection on the sensor's diagonal, whose direction is the mounting's."
_SIGN_SUM = "another sign of one axis is another sum: what added up now cancels."
_LEADING = "the phase is that along the leading axis; where none leads, or little moves along it, noise sets it."
_SLOW = "frames cut slow motion into steps; these leak into all frames."
_STEPS = "within a frame slow motion is an offset, whose axes are merged like a vibration's."
_FRAMES = "frames cut the motion elsewhere, and each frame chooses anew."
_LOST = "it keeps one direction and drops the energy of the two others."

_MATCHED = ("sax321_matched", "say321_matched", "saz321_matched")
_ONE_AXIS = (*_MATCHED, *(f"{name}_running" for name in _MATCHED))
_LEADING_MATCHED = ("pca321_matched", "pca321_matched_windowed")

REASONS: Mapping[tuple[str, str], str] = MappingProxyType({
    ("gain", "sax321"): _SILENT, ("gain", "say321"): _SILENT, ("gain", "saz321"): _SILENT,
    ("gain", "soc321"): "the sum cancels; what is left of it is noise.",
    ("gain", "pca321"): _CHANCE, ("gain", "pca321_adaptive"): _CHANCE,
    ("gain", "dft321"): _SUM_PHASE, ("gain", "dft321_windowed"): _SUM_PHASE,
    ("gain", "dft321_principal"): _LEADING, ("gain", "dft321_principal_windowed"): _LEADING,
    ("rotation", "sax321"): _OWN_AXIS, ("rotation", "say321"): _OWN_AXIS, ("rotation", "saz321"): _OWN_AXIS,
    ("rotation", "soc321"): _DIAGONAL,
    ("rotation", "pca321"): "equal eigenvalues: rounding chooses among equally good axes.",
    ("rotation", "dft321"): "the spectrum stays, but the phase of x + y + z goes with the sensor's diagonal.",
    ("rotation", "dft321_windowed"): "the spectrum stays, but the phase of x + y + z goes with the sensor's diagonal.",
    ("flip", "soc321"): _SIGN_SUM, ("flip", "dft321"): _SIGN_SUM, ("flip", "dft321_windowed"): _SIGN_SUM,
    ("shift", "pca321"): "equal eigenvalues: rounding chooses among equally good axes.",
    ("shift", "pca321_adaptive"): _FRAMES, ("shift", "dft321_windowed"): _FRAMES,
    ("shift", "dft321_principal_windowed"): _FRAMES,
    ("edge", "mag321"): "rectifying turns an offset and a vibration into another envelope.",
    ("edge", "dft321_windowed"): _SLOW, ("edge", "dft321_principal_windowed"): _SLOW,
    ("energy", "sax321"): _LOST, ("energy", "say321"): _LOST, ("energy", "saz321"): _LOST,
    ("energy", "pca321"): _LOST, ("energy", "pca321_adaptive"): _LOST,
    ("energy", "soc321"): "axes in phase add up to too much, axes in anti-phase cancel.",
    ("energy", "mag321"): "the length of the vector is mostly offset, which is not felt; its ripple is what remains.",
    ("fault", "dft321"): "the fault changes the phase of x + y + z at frequencies whose energy it spares.",
    ("fault", "dft321_windowed"): "the fault changes the phase of x + y + z at frequencies whose energy it spares.",
    ("energy", "dft321_windowed"): _STEPS, ("energy", "dft321_principal_windowed"): _STEPS,
    **{("gain", name): _SILENT for name in _ONE_AXIS}, **{("rotation", name): _OWN_AXIS for name in _ONE_AXIS},
    **{("energy", name): "the gain is at most 10: an axis with less than a hundredth of the energy stays weak."
       for name in _ONE_AXIS},
    **{("gain", name): _CHANCE for name in _LEADING_MATCHED},
    ("rotation", "pca321_matched"): "equal eigenvalues: rounding chooses among equally good axes.",
    ("shift", "pca321_matched_windowed"): "where none leads the axis depends on what came first, and is held there.",
})  # fmt: skip
"""(measure, reducer) -> why."""

GENERAL: Mapping[str, str] = MappingProxyType({
    "gain": "the output rests on something that noise decides.",
    "rotation": "the output depends on the sensor's axes.",
    "flip": "the output depends on the signs of the sensor's axes.",
    "shift": "the output depends on where frames begin.",
    "edge": "the envelope of what it keeps is not that of the motion.",
    "energy": "it does not keep the energy of all axes.",
    "fault": "it turns a fault of some samples into another output elsewhere too.",
    "spread": "the metrics of what it keeps change with the mounting; the paper's temporal match does so by itself.",
})  # fmt: skip


def tell_reason(measure: str, reducer: str) -> str:
    """Explain a failure.

    Parameters
    ----------
    measure : str
        A name of `MEASURES`.
    reducer : str
        Any name; one that is not known gets the general reason.

    Returns
    -------
    str
        Half a sentence that ends in a full stop.

    Examples
    --------
    >>> tell_reason("gain", "dft321")
    'the phase is that of x + y + z; where the axes cancel, noise sets it.'
    """
    return REASONS.get((measure, reducer), GENERAL[measure])
