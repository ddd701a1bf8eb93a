"""Fit tire models to measured force-slip data with honest uncertainty.

import jax
jax.config.update("jax_enable_x64", True)
import tirefit

data = tirefit.read("sweep.csv")
fit = tirefit.sample(tirefit.fit(data, "brush-d"))
print(fit)
tirefit.plot_fit(fit)
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach(
    __name__,
    submod_attrs={
        "data.derive": ["derive_files"],
        "data.inspect": ["inspect"],
        "data.read": ["read", "read_frame"],
        "diagnosis.effects": ["EFFECTS", "Effect"],
        "diagnosis.engine": ["diagnose"],
        "diagnosis.rig": ["Rig", "load_rig"],
        "fitting.batch": ["fit_many"],
        "fitting.estimate": ["fit"],
        "fitting.posterior": ["sample"],
        "fitting.predict": ["predict"],
        "fitting.store": ["load_fit", "save_fit"],
        "models": ["MODELS", "TireInputs", "forces"],
        "params": ["parameter_values", "with_values"],
        "report.plots": [
            "compare",
            "plot_corner",
            "plot_fit",
            "plot_profile",
            "plot_residuals",
            "plot_trace",
        ],
        "results": ["DataError", "UsageError"],
    },
)

__version__ = "0.1.0"
