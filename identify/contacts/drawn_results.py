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


def figures_of(found: AnyIdentification, laws: Laws, laws_name: str) -> dict[str, Picture]:
    """All figures by their names, with the reference laws in them."""
    if isinstance(found, SpaceIdentification):
        return space_figures(found, laws, laws_name)
    marks = {name: (law.clearance_m, law.stiffness_n_per_m) for name, law in laws.items()}
    return contact_figures(found, marks, laws_name)


def curves_of(found: AnyIdentification) -> dict[str, Table]:
    """Curves of the figures as tables, by family."""
    return space_curves(found) if isinstance(found, SpaceIdentification) else curves(found)


def write_files(
    found: AnyIdentification, out: Path, title: str, laws: Laws, laws_name: str, sources: Sequence[Path]
) -> None:
    """Write contact.html, the figures, the identified rig.json, and contact.json."""
    if isinstance(found, SpaceIdentification):
        write_space_results(found, out, title, laws, laws_name, sources)
    else:
        write_results(found, out, title, laws, laws_name, sources)
