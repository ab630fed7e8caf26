"""Figures, curves and files of an identification, whether the rig moves in one direction or in two."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from identify.contacts.curves import curves
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
    marks = {name: (law.clearance_m, law.stiffness_n_per_m) for name, law in laws.items()}
    return contact_figures(identification, marks, laws_name)


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
