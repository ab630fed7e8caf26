"""The curves of an identification as tables."""

from identify.contacts.identification import Identification
from identify.pages.tables import Table


def curves(found: Identification) -> dict[str, Table]:
    """Curves by family: `motion` (relative displacements and separated contact forces over time), `surface` (restoring
    force of the main modal equation, as measured and as fitted) and `nifo` (over frequency; not of a free decay).
    """
    names = [c.name for c in found.rig.contacts]
    tables = {"motion": _motion(found)}
    if found.methods.main_surfaces:
        tables["surface"] = _surface(found, names)
    return tables | ({"nifo": _nifo(found, names)} if found.methods.forms else {})


def _motion(found: Identification) -> Table:
    """Curves over time at the rate of the separated forces; contacts between the same places have one in common."""
    factor = found.factor
    force = found.separated_n
    eta = found.eta_m[[place.members[0] for place in found.same_place], ::factor]
    rows = min(eta.shape[1], force.shape[1])
    table: Table = {"time_s": found.motion.time_s(rows, factor)}
    for place, displacement, contact_n in zip(found.same_place, eta, force, strict=True):
        name = place.contact.name
        table[f"{name} relative displacement m"] = displacement[:rows]
        table[f"{name} contact force N"] = contact_n[:rows]
    return table


def _surface(found: Identification, names: list[str]) -> Table:
    surface = found.surface
    eta = found.eta_m[:, :: surface.factor]
    velocity = surface.equation.velocity[:: surface.factor]
    rows = min(eta.shape[1], surface.measured.size, velocity.size)
    table: Table = {"time_s": found.motion.time_s(rows, surface.factor)}
    table |= {f"{name} relative displacement m": row[:rows] for name, row in zip(names, eta, strict=True)}
    table["modal velocity sqrt(kg) m/s"] = velocity[:rows]
    table["restoring force N/sqrt(kg)"] = surface.measured[:rows]
    table["fitted restoring force N/sqrt(kg)"] = surface.fitted[:rows]
    return table


def _nifo(found: Identification, names: list[str]) -> Table:
    """Both forms; each line's FRF of the modal coordinate over the modal force, and stiffness of every contact."""
    table: Table = {"frequency_Hz": found.weak.frequency_hz}
    for form, result in (("weak form", found.weak), ("paper's form", found.paper)):
        rows = {"FRF s^2": result.frf}
        rows |= {
            f"{names[j]} stiffness N/m": row for j, row in zip(result.contacts, result.stiffness_n_per_m, strict=True)
        }
        for name, row in rows.items():
            if result.frequency_hz.size == found.weak.frequency_hz.size:
                table[f"{form} {name} real"], table[f"{form} {name} imaginary"] = row.real, row.imag
    return table
