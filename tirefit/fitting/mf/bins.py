"""placeholder"""

import numpy as np

from tirefit.fitting.mf.rows import ForceRows

__all__ = ["settings_of"]


def settings_of(rows: ForceRows) -> tuple[tuple[str, ...], np.ndarray]:
    keys = [
        _place(rows.column("fz"), 0.2, True),
        _place(rows.column("gamma"), 0.015),
        _place(rows.column("pressure"), 0.05, True),
        np.asarray(rows.run),
    ]
    pure = rows.pure
    other = rows.column("alpha")
    keys.append(np.where(pure, 0, _place(other, 0.025)))
    found, code = np.unique(np.stack(keys), axis=1, return_inverse=True)
    code = code.ravel()
    fz = np.bincount(code, rows.column("fz")) / np.bincount(code)
    return tuple(f"{v:.0f} N {k}" for v, k in zip(fz, found.T)), code


def _place(values, width, log=False):
    if log:
        return np.rint(np.log(np.maximum(values, 1e-9)) / width).astype(int)
    return np.rint(values / width).astype(int)
