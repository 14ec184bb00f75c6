from __future__ import annotations

import numpy as np
import pytest

from feel321.analysis.arrays import read_numbers


@pytest.mark.parametrize("given", [[[1, 2], [3]], [np.zeros((2, 2)), np.zeros((2, 3))]])
def test_what_has_no_shape_is_refused_in_words(given: object) -> None:
    with pytest.raises(ValueError, match="table must hold numbers: "):
        read_numbers(given, what="table")
