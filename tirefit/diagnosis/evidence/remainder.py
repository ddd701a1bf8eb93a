"""What a remainder may look like on the rows of one file, all channels together."""

import numpy as np

from tirefit.diagnosis.evidence.forms import PLACE
from tirefit.diagnosis.evidence.forward import Design
from tirefit.diagnosis.rows.basis import Generic, wide_bases
from tirefit.diagnosis.rows.patterns import PARAMETERS, patterns
from tirefit.diagnosis.rows.prepared import Prepared


def whitened_generic(
    rows: Prepared, design: Design, slip_fraction, fields: np.ndarray
) -> Generic:
    """Generic functions for each channel by itself, whitened: (m, b).

    Args:
        slip_fraction: signed slip over that of full sliding, (n,).
        fields: (m, F) of :class:`tirefit.diagnosis.evidence.forward.Linear`.
    """
    n, channels = rows.n, rows.channels
    keep, bases = np.asarray(design.keep)[:n, None], []
    for channel in channels:
        typical = rows.inputs.fz / np.asarray(design.scale[channel])[:n]
        bases.append(wide_bases(rows, slip_fraction, typical))

    def stacked(parts):
        blocks = [
            np.concatenate([
                part * keep if row == k else np.zeros((n, part.shape[1]))
                for row in range(len(channels))
            ])
            for k, part in enumerate(parts)
        ]  # fmt: skip
        return np.concatenate(blocks, axis=1)

    by_name = {name: fields[:, PLACE[field]] for name, (field, _) in PARAMETERS.items()}
    smooth, cells, waves = (stacked(parts) for parts in zip(*bases, strict=True))
    return Generic(smooth, cells, waves, patterns(rows, slip_fraction, by_name))
