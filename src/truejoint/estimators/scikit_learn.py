"""A regressor that runs by scikit-learn itself, kept as an archive in which there is no code."""

from __future__ import annotations

from typing import Final

from truejoint.estimators.family import Family, Params, Rule, Shape, integer

MAX_BYTES: Final = 96 * 2**20
MAX_PROBES: Final = 8


def _shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
    n_probes = int(params["n_probes"])
    return {
        "words": (-(-int(params["n_bytes"]) // 4),),
        "target_mean": (n_outputs,),
        "target_scale": (n_outputs,),
        "probes": (n_probes, n_features),
        "answers": (n_probes, n_outputs),
    }


FAMILY: Final = Family(
    "scikit_learn",
    rules={
        "n_bytes": integer(1, MAX_BYTES),
        "n_probes": integer(1, MAX_PROBES),
        "version": Rule(
            lambda v: isinstance(v, str) and 1 <= len(v) <= 40 and v.isprintable(),
            "a version of scikit-learn",
        ),
    },
    shapes=_shapes,
    offline=(
        "is run by scikit-learn (linear models, trees, forests, boosted trees and logistic "
        "networks are not)"
    ),
)
"""Arrays: ``words``, the bytes of the archive, four to a number; ``target_mean`` and
``target_scale`` of each output, which it was fitted to less the mean, over the scale; ``probes``
and ``answers``, rows and what it predicted for them where it was fitted."""
