"""The nearest physical body to one that no mass distribution has."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

LEAST = 1e-3  # of the largest second moment: a body is that thick at least


def mend(model: pin.Model) -> list[str]:
    """Give each moving body of the model the nearest physical inertia, in place; a line for each change.

    A body's second moments about its centre of mass, S = tr(I)/2 - I, are those of its mass: none is below
    zero. Where one is, it is raised, along its own axis, to `LEAST` of the largest; the moments follow as
    I = tr(S) - S. Mass and centre of mass stay.
    """
    told = []
    for joint in range(1, model.njoints):
        body = model.inertias[joint]
        moments, axes = np.linalg.eigh(body.inertia)
        second = moments.sum() / 2 - moments
        if body.mass <= 0 or second.min() >= 0 or second.max() <= 0:
            continue
        second = np.maximum(second, LEAST * second.max())
        physical = second.sum() - second
        model.inertias[joint] = pin.Inertia(body.mass, body.lever, (axes * physical) @ axes.T)
        changes = ", ".join(f"{old:.4g} -> {new:.4g}" for old, new in zip(moments, physical, strict=True))
        told.append(f"body of joint {model.names[joint]!r}: principal moments {changes} kg m^2")
    return told
