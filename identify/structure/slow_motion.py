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
    """Of every body. Where no sensor shows the zero of displacements, the springs of some modes act on the high-passed
    displacement alone.

    Only modes that are then free tell a constant contact force from accelerations. So these are the modes that would be
    rigid but for attached springs, the mode of a single mass, and further the lowest that move the contacts, until
    every contact force is told.

    Raises RigError if no number of modes tells every contact force.
    """
    found = tuple(response_of(rig, body, omega) for body in rig.bodies)
    over = np.concatenate([across(rig, r) for r in found], axis=1)
    own = [(k, m) for k, r in enumerate(found) for m in range(r.count)]
    least = RANK * float(np.max(np.abs(over), initial=0.0))

    def told(modes: list[int]) -> int:
        return int(np.linalg.matrix_rank(over[:, modes], least)) if modes else 0

    if told(list(range(len(own)))) < len(rig.contacts):
        raise RigError(
            f"the {len(rig.contacts)} contacts of rig {rig.name!r} move by fewer independent modes; describe more "
            "modes, or fewer contacts"
        )
    if zero_known:
        return found
    chosen = [i for i, (k, m) in enumerate(own) if m < max(found[k].body.rigid_modes, found[k].body.is_mass)]
    for i in sorted(range(len(own)), key=lambda i: found[own[i][0]].dynamics.natural_hz[own[i][1]]):
        if told(chosen) < len(rig.contacts) and told([*chosen, i]) > told(chosen):
            chosen.append(i)
    loose = [tuple(sorted(own[i][1] for i in chosen if own[i][0] == k)) for k in range(len(found))]
    return tuple(replace(r, dynamics=r.dynamics.with_high_passed(m)) for r, m in zip(found, loose, strict=True))


def slow_damping(
    rig: Rig, responses: tuple[Response, ...], slow_n_per_m: Float[np.ndarray, "contacts contacts"]
) -> Float[np.ndarray, "contacts contacts"]:
    """The contact forces (N s) per slow relative velocity (m/s): K M K, M = sum of phi phi' 2 zeta / omega^3."""
    over = np.concatenate([across(rig, r) for r in responses], axis=1)
    omega = 2 * np.pi * np.concatenate([r.dynamics.natural_hz for r in responses])
    zeta = np.concatenate([r.dynamics.damping_ratios for r in responses])
    held, rate = over[:, omega > 0], 2 * zeta[omega > 0] / omega[omega > 0] ** 3
    return np.asarray(slow_n_per_m @ (held * rate) @ held.T @ slow_n_per_m)


def slow_stiffness(rig: Rig, responses: tuple[Response, ...]) -> Float[np.ndarray, "contacts contacts"]:
    """The contact forces (N) that slow relative displacements (m) take, where springs act on the high-passed ones.

    With C the sum of phi phi' / omega^2 over the modes that are held, and N the combinations of contacts which no free
    mode moves, K = N (N' C N)^-1 N'. Zero where no mode's spring acts on the high-passed displacement.
    """
    over = np.concatenate([across(rig, r) for r in responses], axis=1)
    omega = 2 * np.pi * np.concatenate([r.dynamics.natural_hz for r in responses])
    combined, sizes, _ = np.linalg.svd(over[:, omega == 0])
    still = combined[:, np.count_nonzero(sizes > RANK * np.max(np.abs(over), initial=0.0)) :]
    if not (still.size and any(np.any(r.dynamics.natural_hz[list(r.dynamics.high_passed)]) for r in responses)):
        return np.zeros((len(over), len(over)))
    held = over[:, omega > 0]
    compliance = still.T @ (held / omega[omega > 0] ** 2) @ held.T @ still
    return np.asarray(still @ np.linalg.pinv(compliance, rcond=1e-12, hermitian=True) @ still.T)
