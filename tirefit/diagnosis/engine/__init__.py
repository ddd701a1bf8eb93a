"""The inference of a diagnosis, the same for rows of a tire, of a simulator, and windows
of a car: search, posterior, data left out, sizes by group, decision. All of it reads fits
linearised and whitened (:class:`~tirefit.diagnosis.engine.fit.Fit`)."""
