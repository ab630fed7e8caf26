"""Slow motion, which accelerations do not tell: where springs then act, and how stiffly they hold the contacts."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from identify.structure.response import Response, across, response_of
from rig.errors import RigError
from rig.model.description import Rig

RANK = 1e-9
"""A mode that moves a contact by a smaller share of the largest does not move it."""


def responses_of(rig: Rig, omega: Float[np.ndarray, " lines"], zero_known: bool) -> tuple[Response, ...]:
    """Of every body. Where no sensor shows the zero of displacements, the springs of some of the lowest modes act on
    the high-passed displacement alone.

    Only modes that are then free tell a constant contact force from accelerations. So these are the modes that would be
    rigid but for attached springs, the mode of a single mass, and further the lowest of all until every contact force
    is told.

    Raises RigError if no number of modes tells every contact force.
    """
    found = tuple(response_of(rig, body, omega) for body in rig.bodies)
    over = [across(rig, r) for r in found]
    contacts, least = len(rig.contacts), RANK * max(float(np.max(np.abs(o), initial=0.0)) for o in over)

    def told(counts: list[int]) -> int:
        by_modes = np.concatenate([o[:, :n] for o, n in zip(over, counts, strict=True)], axis=1)
        return int(np.linalg.matrix_rank(by_modes, least))

    if contacts and told([r.count for r in found]) < contacts:
        raise RigError(
            f"the {contacts} contacts of rig {rig.name!r} move by fewer independent modes; describe more modes, or "
            "fewer contacts"
        )
    if zero_known:
        return found
    counts = [1 if r.body.is_mass else r.body.rigid_modes for r in found]
    while told(counts) < contacts:
        following = [r.dynamics.natural_hz[n] if n < r.count else np.inf for r, n in zip(found, counts, strict=True)]
        touched = [np.any(o) for o in over]
        counts[int(np.argmin(np.where(touched, following, np.inf)))] += 1
    return tuple(replace(r, dynamics=r.dynamics.with_high_passed(n)) for r, n in zip(found, counts, strict=True))


def slow_stiffness(rig: Rig, responses: tuple[Response, ...]) -> Float[np.ndarray, "contacts contacts"]:
    """The contact forces (N) that slow relative displacements (m) take, where springs act on the high-passed ones.

    With C the sum of phi phi' / omega^2 over the modes that are held, and N the combinations of contacts which no free
    mode moves, K = N (N' C N)^-1 N'. Zero where no mode's spring acts on the high-passed displacement.
    """
    over = np.concatenate([across(rig, r) for r in responses], axis=1)
    omega = 2 * np.pi * np.concatenate([r.dynamics.natural_hz for r in responses])
    combined, sizes, _ = np.linalg.svd(over[:, omega == 0])
    still = combined[:, np.count_nonzero(sizes > RANK * np.max(np.abs(over), initial=0.0)) :]
    if not (still.size and any(np.any(r.dynamics.natural_hz[: r.dynamics.high_passed]) for r in responses)):
        return np.zeros((len(over), len(over)))
    held = over[:, omega > 0]
    compliance = still.T @ (held / omega[omega > 0] ** 2) @ held.T @ still
    return np.asarray(still @ np.linalg.pinv(compliance, rcond=1e-12, hermitian=True) @ still.T)
