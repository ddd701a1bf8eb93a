"""Selection of the slip whose noise is integrated out, for each force."""

from collections.abc import Collection, Sequence

import numpy as np

from tirefit.data.table import TireData
from tirefit.fitting.problem.likelihood import CHANNEL_SLIP
from tirefit.models import AbstractTire, TireInputs
from tirefit.results import DataError


def slip_of_forces(
    data: TireData, model: AbstractTire, forces: Sequence[str], noisy: Collection[str]
) -> dict[str, str]:
    """Force -> the slip whose noise is integrated out for it.

    In pure slip, and for a model of pure slip, it is the slip of the force. In combined
    slip every force depends on both, so all share the latent values of the noisy one.

    Args:
        data: the rows to be fitted.
        model: the model of the fit.
        forces: the fitted forces.
        noisy: those of sigma_x and alpha whose noise is given.

    Raises:
        DataError: combined slip with noise of both slips.
    """
    own = {force: CHANNEL_SLIP[force] for force in forces}
    if not noisy or not (_has_combined_rows(data) and _couples(model)):
        return own
    if len(noisy) > 1:
        raise DataError(
            "noise of both sigma_x and alpha in combined slip: every force depends"
            " on both slips, and only one noisy slip can be integrated out",
            "give the noise of the slip that matters more, and count that of the"
            " other as noise of the forces; or fit rows of pure slip",
            data.file,
        )
    (slip,) = noisy
    return dict.fromkeys(forces, slip)


def _has_combined_rows(data: TireData) -> bool:
    """Whether both slips matter together in more than a twentieth of the rows."""
    if "sigma_x" not in data or "alpha" not in data:
        return False
    slips = np.nan_to_num([data.usable("sigma_x"), np.tan(data.usable("alpha"))])
    # The slip of a locked wheel represents infinity.
    sizes = np.minimum(np.abs(slips), 1.0)
    smaller, largest = sizes.min(axis=0), np.hypot(*sizes).max(initial=0.0)
    return bool(np.mean(smaller > 0.05 * largest) > 0.05)


def _couples(model: AbstractTire) -> bool:
    """Whether one slip changes the force of the other."""
    both = model(TireInputs(0.1, 0.1, 4000.0, 10.0))
    along = model(TireInputs(0.1, 0.0, 4000.0, 10.0))
    across = model(TireInputs(0.0, 0.1, 4000.0, 10.0))
    pairs = ((both.fx, along.fx), (both.fy, across.fy))
    return any(
        a is not None and b is not None and bool(abs(a - b) > 1e-6 * abs(b)) for a, b in pairs
    )
