"""Fit tire models to measured force-slip data with honest uncertainty.

import jax
jax.config.update("jax_enable_x64", True)
import tirefit

data = tirefit.read("sweep.csv")
fit = tirefit.sample(tirefit.fit(data, "brush-d"))
print(fit)
fit.plot()

Sources
-------
S(n) and O(n) are equations, S §n sections and Figures, of the two sources:

S
    Svendenius, J., Wittenmark, B.: Review of Wheel Modeling and Friction Estimation.
    Technical Report TFRT-7607, Department of Automatic Control, Lund Institute of
    Technology, 2003. ISSN 0280-5316, ISRN LUTFD2/TFRT--7607--SE.
O
    Ono, E., Asano, K., Sugai, M., Ito, S., Yamamoto, M., Sawada, M., Yasui, Y.:
    Estimation of automotive tire force characteristics using wheel velocity. 15th IFAC
    World Congress, Barcelona, 2002; Control Engineering Practice 11 (2003) 1361-1370.

``EQUATIONS.md`` of the repository has a line for each equation, and what is corrected
in it. P(4.E...) are equations of Pacejka (2012). Other papers whose methods the code uses are
in ``docs/reference/sources.md``.
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach(
    __name__,
    submod_attrs={
        "data.vehicle.derive": ["derive_files"],
        "data.inspect": ["inspect"],
        "data.rig.prepare": ["prepare"],
        "data.read": ["read", "read_frame"],
        "diagnosis.effects": ["EFFECTS", "Effect"],
        "diagnosis.diagnose": ["diagnose"],
        "diagnosis.summary.compare": ["compare"],
        "diagnosis.rows.rig": ["Rig", "load_rig"],
        "fitting.solve.batch": ["fit_many"],
        "fitting.estimate": ["fit"],
        "fitting.verdict.identifiability": ["identifiability"],
        "fitting.mf.fit": ["fit_magic_formula"],
        "fitting.uncertainty.posterior": ["sample"],
        "fitting.predict": ["predict"],
        "fitting.store": ["load_fit"],
        "online.estimate": ["estimate"],
        "online.methods": ["METHODS"],
        "models": ["MODELS", "TireInputs", "forces"],
        "params": ["parameter_values", "with_values"],
        "targets.explore": ["explore"],
        "targets.export": ["export"],
        "report.many_files": ["write_fits_page"],
        "results": ["DataError", "UsageError"],
        "sim.manoeuvre": ["brake"],
        "sim.simulate": ["simulate"],
        "vehicle.diagnose": ["diagnose_vehicle"],
        "vehicle.replay": ["replay"],
        "vehicle.simulated": ["compare_with_simulator"],
        "vehicle.trajectory": ["fit_trajectory"],
    },
)

__version__ = "0.1.0"
