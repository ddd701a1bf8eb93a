"""Laws of the noise that are said by a name of their own."""

from tirefit.diagnosis.effects.record import NoiseEffect

NOISE_EFFECTS = (
    NoiseEffect(
        id="outliers",
        flag="outliers",
        means="rows far off all others",
        remedy="set [noise] loss = 'huber'",
    ),  # fmt: skip
    NoiseEffect(
        id="noise_heteroscedastic",
        means="noise that differs over the range",
        remedy="give fx_std row by row",
    ),  # fmt: skip
    NoiseEffect(
        id="noise_autocorrelated",
        flag="autocorrelated",
        means="neighbouring rows share their noise",
        remedy="none needed: rows count at their effective number",
    ),  # fmt: skip
    NoiseEffect(
        id="slip_noise",
        means="the slip is measured with noise",
        remedy="give sigma_x_std",
    ),  # fmt: skip
)
"""They change the error law and not the mean."""
