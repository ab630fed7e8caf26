"""Figures, curves and files of an identification, whether the rig moves in one direction or in two."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Complex

from identify.contacts.figures import contact_figures
from identify.contacts.identification import Identification
from identify.contacts.report import write_results
from identify.contacts.space_figures import space_curves, space_figures
from identify.contacts.space_identification import SpaceIdentification
from identify.contacts.space_report import write_space_results
from identify.pages.style import Picture
from identify.pages.tables import Table
from rig.model.contact_laws import ContactLaw

Laws = Mapping[str, ContactLaw]
AnyIdentification = Identification | SpaceIdentification


def figures_of(identification: AnyIdentification, laws: Laws, laws_name: str) -> dict[str, Picture]:
    """All figures by their names, with the reference laws in them."""
    if isinstance(identification, SpaceIdentification):
        return space_figures(identification, laws, laws_name)
    reference_values = {name: (law.clearance_m, law.stiffness_n_per_m) for name, law in laws.items()}
    return contact_figures(identification, reference_values, laws_name)


def curves_of(identification: AnyIdentification) -> dict[str, Table]:
    """Curves of the figures as tables, by family."""
    return space_curves(identification) if isinstance(identification, SpaceIdentification) else curves(identification)


def write_files(
    identification: AnyIdentification, out: Path, title: str, laws: Laws, laws_name: str, sources: Sequence[Path]
) -> None:
    """Write contact.html, the figures, the identified rig.json, and contact.json."""
    if isinstance(identification, SpaceIdentification):
        write_space_results(identification, out, title, laws, laws_name, sources)
    else:
        write_results(identification, out, title, laws, laws_name, sources)


def curves(result: Identification) -> dict[str, Table]:
    """Curves by family: `motion` (relative displacements and separated contact forces over time), `surface` (restoring
    force of the main modal equation, as measured and as fitted) and `nifo` (over frequency; not of a free decay).
    """
    contact_names = [contact.name for contact in result.rig.contacts]
    tables = {"motion": _motion_table(result)}
    if result.methods.main_surfaces:
        tables["surface"] = _surface_table(result, contact_names)
    return tables | ({"nifo": _nifo_table(result, contact_names)} if result.methods.main_nifo_results else {})


def _motion_table(result: Identification) -> Table:
    """Curves over time at the rate of the separated forces, one pair of columns per pair of places."""
    decimation, separated_n = result.decimation, result.separated_n
    group_eta_m = result.eta_m[[group.contact_indices[0] for group in result.contact_groups], ::decimation]
    row_count = min(group_eta_m.shape[1], separated_n.shape[1])
    table: Table = {"time_s": result.motion.time_s(row_count, decimation)}
    for group, eta_m, force_n in zip(result.contact_groups, group_eta_m, separated_n, strict=True):
        table[f"{group.joined_contact.name} relative displacement m"] = eta_m[:row_count]
        table[f"{group.joined_contact.name} contact force N"] = force_n[:row_count]
    return table


def _surface_table(result: Identification, names: list[str]) -> Table:
    """Relative displacements, modal velocity and restoring force of the main modal equation over time."""
    surface = result.surface
    etas = result.eta_m[:, :: surface.decimation]
    modal_velocity = surface.equation.velocity[:: surface.decimation]
    row_count = min(etas.shape[1], surface.measured_modal_force.size, modal_velocity.size)
    table: Table = {"time_s": result.motion.time_s(row_count, surface.decimation)}
    table |= {f"{name} relative displacement m": eta_row[:row_count] for name, eta_row in zip(names, etas, strict=True)}
    table["modal velocity sqrt(kg) m/s"] = modal_velocity[:row_count]
    table["restoring force N/sqrt(kg)"] = surface.measured_modal_force[:row_count]
    table["fitted restoring force N/sqrt(kg)"] = surface.fitted_modal_force[:row_count]
    return table


def _nifo_table(result: Identification, contact_names: list[str]) -> Table:
    """FRF of the modal coordinate over the modal force, and stiffness of every contact, by both forms of NIFO."""
    weak_nifo, paper_nifo = result.weak_nifo, result.paper_nifo
    table: Table = {"frequency_Hz": weak_nifo.frequency_hz}
    for form, nifo in (("weak form", weak_nifo), ("paper's form", paper_nifo)):
        if nifo.frequency_hz.size != weak_nifo.frequency_hz.size:
            continue
        table |= _complex_columns(f"{form} FRF s^2", nifo.frf)
        for contact_index, stiffness in zip(nifo.contact_indices, nifo.stiffness_n_per_m, strict=True):
            table |= _complex_columns(f"{form} {contact_names[contact_index]} stiffness N/m", stiffness)
    return table


def _complex_columns(name: str, spectrum: Complex[np.ndarray, " lines"]) -> Table:
    return {f"{name} real": spectrum.real, f"{name} imaginary": spectrum.imag}
