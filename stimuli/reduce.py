"""REDUCERS: the one list of the 321 transforms, in the order of the paper, simplest first; later ones follow.

Every reducer is called alike, `REDUCERS[name](acceleration, rate_hz)`: acceleration of shape (..., 3, n_samples), any
unit, in; the reduced signal, shape (..., n_samples), float64, same unit, out. Deterministic; the input is never
modified.

References
----------
.. [1] N. Landin, J. M. Romano, W. McMahan, K. J. Kuchenbecker, "Dimensional reduction of high-frequency accelerations
   for haptic rendering", EuroHaptics 2010. doi:10.1007/978-3-642-14075-4_12
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Protocol

from stimuli.axes import mag321, sax321, say321, saz321, soc321
from stimuli.fourier import dft321, dft321_windowed
from stimuli.leading import dft321_principal
from stimuli.matched import (
    pca321_matched,
    pca321_matched_windowed,
    sax321_matched,
    sax321_matched_running,
    say321_matched,
    say321_matched_running,
    saz321_matched,
    saz321_matched_running,
)
from stimuli.principal import pca321, pca321_adaptive
from stimuli.tracking import dft321_principal_windowed

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import ArrayLike, NDArray


class Reducer(Protocol):
    """A 321 transform: (..., 3, n_samples) -> (..., n_samples)."""

    def __call__(self, acceleration: ArrayLike, rate_hz: float, /) -> NDArray[np.float64]:
        """Reduce three axes of acceleration to one."""


REDUCERS: Mapping[str, Reducer] = MappingProxyType(
    {
        "sax321": sax321,
        "say321": say321,
        "saz321": saz321,
        "soc321": soc321,
        "mag321": mag321,
        "pca321": pca321,
        "pca321_adaptive": pca321_adaptive,
        "dft321": dft321,
        "dft321_windowed": dft321_windowed,
        "dft321_principal": dft321_principal,
        "dft321_principal_windowed": dft321_principal_windowed,
        "sax321_matched": sax321_matched,
        "say321_matched": say321_matched,
        "saz321_matched": saz321_matched,
        "pca321_matched": pca321_matched,
        "sax321_matched_running": sax321_matched_running,
        "say321_matched_running": say321_matched_running,
        "saz321_matched_running": saz321_matched_running,
        "pca321_matched_windowed": pca321_matched_windowed,
    }
)
"""Name -> reducer."""

DEFAULT_REDUCERS = tuple(REDUCERS)[:9]
"""What a study compares unless it says otherwise: as many as a MUSHRA page holds beside the reference and anchors."""


def get_reducer(name: str) -> Reducer:
    """Look a reducer up, or say which there are.

    Parameters
    ----------
    name : str
        One of `REDUCERS`.

    Returns
    -------
    Reducer
        The transform.

    Raises
    ------
    ValueError
        If there is none of that name.
    """
    try:
        return REDUCERS[name]
    except KeyError:
        raise ValueError(f"reducer: got {name!r}, allowed is one of {', '.join(REDUCERS)}") from None
