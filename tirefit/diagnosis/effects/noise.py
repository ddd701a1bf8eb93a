"""Laws of the noise that are said by a name of their own."""

from tirefit.diagnosis.effects.record import NoiseEffect

NOISE_EFFECTS = (
    NoiseEffect(
        id="outliers",
        flag="outliers",
        means="rows far off all others",
        remedy="set [noise] loss = 'huber'",
    ),
    NoiseEffect(
        id="noise_heteroscedastic",
        means="noise that differs over the range",
        remedy="give fx_std row by row",
    ),
    NoiseEffect(
        id="noise_autocorrelated",
        flag="autocorrelated",
        means="neighbouring rows share their noise",
        remedy="none needed: rows count at their effective number",
    ),
    NoiseEffect(
        id="slip_noise",
        means="the slip is measured with noise",
        remedy="give sigma_x_std",
    ),
)
"""They change the error law and not the mean."""
