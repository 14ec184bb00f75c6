"""Read a MATLAB file in a process of its own: `python matlab.py FILE LIMIT` writes its plain arrays to stdout as NPZ.

A damaged element makes scipy's compiled reader read outside its tables, which ends the whole process, and a small file
may inflate without end. So this one may die, or run out of the memory that it is given. It imports nothing of feel321:
it starts in half a second.
"""

import sys
import warnings


def main(path: str, limit: int) -> None:
    """Write all arrays of real or complex numbers and texts."""
    try:
        import resource

        # What is inflated, its copies, and what libraries map before they hold anything.
        resource.setrlimit(resource.RLIMIT_AS, (3 * limit + 2**30,) * 2)
    except ImportError:  # Windows has no such limit
        pass
    import numpy as np
    from scipy.io import loadmat

    warnings.filterwarnings("error", message="Duplicate variable")
    arrays = {name: one for name, one in loadmat(path).items() if isinstance(one, np.ndarray)}
    plain = {name for name, one in arrays.items() if one.dtype.kind in "biufcU"}
    found = {name: arrays[name] for name in plain if not name.startswith("__")}
    if (total := sum(array.nbytes for array in found.values())) > limit:
        raise MemoryError(f"its variables take {total / 1e6:,.0f} MB")
    np.savez(sys.stdout.buffer, allow_pickle=False, **found)


if __name__ == "__main__":
    try:
        main(sys.argv[1], int(sys.argv[2]))
    except Exception as error:  # noqa: BLE001 - whatever it is, the parent words it
        sys.exit(f"{type(error).__name__}: {error}")
