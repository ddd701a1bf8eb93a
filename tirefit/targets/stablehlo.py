"""A tire as a compiled JAX program (StableHLO) in a Python module."""

import base64
import textwrap

import jax
import jax.numpy as jnp
from jax import export

from tirefit.targets.code import Draft
from tirefit.targets.tire import INPUTS

_PLATFORMS = ("cpu", "cuda", "rocm", "tpu")

_LOADER = '''\
import base64

import jax
import jax.numpy as jnp
import jax.export

_PROGRAM = """
{program}
"""
_PROGRAM = jax.export.deserialize(bytearray(base64.b64decode(_PROGRAM)))


def {name}({inputs}):
    """Forces ({outputs}) of arrays or numbers; within jax.jit, and differentiable once
    backwards (jax.grad, jax.vjp). Arrays take the place of jax.vmap."""
    if not jax.config.jax_enable_x64:
        raise RuntimeError("first: jax.config.update('jax_enable_x64', True)")
    given = [jnp.asarray(one, float) for one in ({inputs},)]
    given = jnp.broadcast_arrays(*given)
    found = _PROGRAM.call(*(one.ravel() for one in given))
    return tuple(one.reshape(given[0].shape) for one in found)
'''


_PATHS = "jax_hlo_source_file_canonicalization_regex"
"""Option of JAX: the part of the names of local files that a program does not state."""


def jax_source(draft: Draft) -> str:
    """A Python module with a function of arrays; it needs only JAX."""
    names, forces = draft.forces.inputs, draft.tire.function(draft.convention)

    def one(*given):
        known = dict(zip(names, given, strict=True))
        found = forces(*(known.get(name, 0.0) for name in INPUTS))
        return tuple(jnp.asarray(force, float) for force in found)

    shape = export.symbolic_shape("n")
    arrays = [jax.ShapeDtypeStruct(shape, jnp.float64)] * len(names)
    before = getattr(jax.config, _PATHS)
    jax.config.update(_PATHS, ".*")
    try:
        program = export.export(jax.jit(jax.vmap(one)), platforms=_PLATFORMS)(*arrays)
        text = base64.b64encode(program.serialize(vjp_order=1)).decode()
    finally:
        jax.config.update(_PATHS, before)
    above = [*draft.above, f"StableHLO of jax {jax.__version__}, for {_PLATFORMS}"]
    loader = _LOADER.format(
        program="\n".join(textwrap.wrap(text, 88)),
        name=draft.name,
        inputs=", ".join(names),
        outputs=", ".join(draft.forces.outputs),
    )
    return "\n".join([*(f"# {line}" for line in above), "", loader])
