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
in it. P(4.E...) are equations of Pacejka (2012). Cited elsewhere:

- Bell, R. M., McCaffrey, D. F.: Bias reduction in standard errors for linear regression
  with multi-stage samples. Survey Methodology 28 (2002) 169-181.
- Benjamini, Y., Yekutieli, D.: The control of the false discovery rate in multiple
  testing under dependency. Annals of Statistics 29 (2001) 1165-1188.
- Berndt, E. K., Hall, B. H., Hall, R. E., Hausman, J. A.: Estimation and inference in
  nonlinear structural models. Annals of Economic and Social Measurement 3 (1974)
  653-665.
- Besselink, I. J. M., Schmeitz, A. J. C., Pacejka, H. B.: An improved Magic
  Formula/Swift tyre model that can handle inflation pressure changes. Vehicle System
  Dynamics 48, supplement (2010) 337-352.
- Bosch, Robert, GmbH (ed.): Automotive Handbook, 9th edition. Wiley, 2014.
- Canudas-de-Wit, C., Tsiotras, P., Velenis, E., Basset, M., Gissinger, G.: Dynamic
  friction models for road/tire longitudinal interaction. Vehicle System Dynamics 39
  (2003) 189-226. The LuGre tire of S(17) and S(18).
- Chandler, R. E., Bate, S.: Inference for clustered data using the independence
  loglikelihood. Biometrika 94 (2007) 167-183.
- DerSimonian, R., Laird, N.: Meta-analysis in clinical trials. Controlled Clinical Trials 7
  (1986) 177-188.
- Foreman-Mackey, D., Hogg, D. W., Lang, D., Goodman, J.: emcee: The MCMC Hammer.
  Publications of the Astronomical Society of the Pacific 125 (2013) 306-312.
- Gäfvert, M., Svendenius, J.: A novel semi-empirical tire model for combined slips.
  Vehicle System Dynamics 43 (2005) 351-384.
- Godambe, V. P.: An optimum property of regular maximum likelihood estimation. Annals of
  Mathematical Statistics 31 (1960) 1208-1211.
- Grosch, K. A.: The relation between the friction and visco-elastic properties of rubber.
  Proceedings of the Royal Society of London A 274 (1963) 21-39.
- Hausman, J. A.: Specification tests in econometrics. Econometrica 46 (1978) 1251-1271.
- Hoffman, M. D., Gelman, A.: The No-U-Turn Sampler. Journal of Machine Learning
  Research 15 (2014) 1593-1623.
- Huber, P. J.: Robust estimation of a location parameter. Annals of Mathematical
  Statistics 35 (1964) 73-101.
- Kitagawa, G.: Monte Carlo filter and smoother for non-Gaussian nonlinear state space
  models. Journal of Computational and Graphical Statistics 5 (1996) 1-25.
- Levenberg, K.: A method for the solution of certain non-linear problems in least
  squares. Quarterly of Applied Mathematics 2 (1944) 164-168.
- Liu, C.-S., Peng, H.: Road friction coefficient estimation for vehicle path
  prediction. Vehicle System Dynamics 25, supplement (1996) 413-425.
- Murphy, S. A., van der Vaart, A. W.: On profile likelihood. Journal of the American
  Statistical Association 95 (2000) 449-465.
- Neal, R. M.: MCMC using Hamiltonian dynamics. Handbook of Markov Chain Monte Carlo,
  chapter 5. Chapman & Hall/CRC, 2011.
- Pacejka, H. B.: Tire and Vehicle Dynamics, 3rd edition. Butterworth-Heinemann, 2012.
- Pickands, J.: Statistical inference using extreme order statistics. Annals of
  Statistics 3 (1975) 119-131.
- ter Braak, C. J. F.: A Markov chain Monte Carlo version of the genetic algorithm
  Differential Evolution. Statistics and Computing 16 (2006) 239-249.
- Sellke, T., Bayarri, M. J., Berger, J. O.: Calibration of p values for testing precise
  null hypotheses. The American Statistician 55 (2001) 62-71.
- Vehtari, A., Gelman, A., Simpson, D., Carpenter, B., Bürkner, P.-C.:
  Rank-normalization, folding, and localization: an improved R-hat for assessing
  convergence of MCMC. Bayesian Analysis 16 (2021) 667-718.
- Vehtari, A., Simpson, D., Gelman, A., Yao, Y., Gabry, J.: Pareto smoothed importance
  sampling. Journal of Machine Learning Research 25 (2024) 72.
- Venzon, D. J., Moolgavkar, S. H.: A method for computing profile-likelihood-based
  confidence intervals. Applied Statistics 37 (1988) 87-94.
- Wood, S. N., Fasiolo, M.: A generalized Fellner-Schall method for smoothing parameter
  optimization with application to Tweedie location, scale and shape models. Biometrics 73
  (2017) 1071-1081.
- Zhang, J., Stephens, M. A.: A new and efficient estimation method for the generalized
  Pareto distribution. Technometrics 51 (2009) 316-325.
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
