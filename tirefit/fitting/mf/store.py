"""A fitted Magic Formula on disk: ``fit.tir`` and ``fit.json``."""

import os
from pathlib import Path

from tirefit.data.tir import new_tir
from tirefit.data.tir_file import TirFile
from tirefit.files import write_texts
from tirefit.fitting.mf.parts import VERSIONS
from tirefit.fitting.mf.result import MagicFormulaFit
from tirefit.params import parameter_values, specs


def tir_of(fit: MagicFormulaFit) -> TirFile:
    """The tire property file of a fit; comments give origin and standard error."""
    version = VERSIONS[fit.model]
    known = specs(fit.tire)
    notes = {}
    for name, one in fit.coefficients.items():
        error = f" +- {one.std:.3g}" if one.std else ""
        notes[name] = f"{known[name].meaning}; {one.origin}{error}"
    comment = [
        f"Magic Formula {version} fitted by tirefit {fit.version}",
        f"to {', '.join(Path(file).name for file in fit.data['file'].split(', '))}",
        f"forces: {', '.join(fit.forces)}; ISO-W axes; standard errors after +-",
        *fit.notes,
    ]
    if missing := {"fx", "fy", "mz"} - set(fit.forces):
        of = {one.origin for one in fit.coefficients.values()}
        other = " or borrowed" if "borrowed" in of else ""
        message = f"not fitted: {', '.join(sorted(missing))}; values of priors{other}"
        comment.append(message)
    lost = {k for k, one in fit.coefficients.items() if one.part in fit.tire.lacks}
    values = {k: v for k, v in parameter_values(fit.tire).items() if k not in lost}
    return new_tir(version, values, fit.ranges, notes, comment)


def save_magic_formula(fit: MagicFormulaFit, directory: str | os.PathLike) -> list[Path]:
    """Write ``fit.tir`` and ``fit.json``, both or none."""
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    texts = {"fit.tir": tir_of(fit).text, "fit.json": fit.to_json()}
    write_texts({directory / name: text for name, text in texts.items()})
    return [directory / name for name in texts]
