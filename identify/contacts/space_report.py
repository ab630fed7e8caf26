"""Results of an identification in space on disk: contact.json, the identified rig.json, the figures, contact.html."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from identify.contacts.annular_law import CLEARANCE, DAMPING, FRICTION, STIFFNESS
from identify.contacts.assumptions import station_positions_text, tolerances_sentence
from identify.contacts.report import (
    FOOT_TEXT,
    Laws,
    answer,
    drawing_html,
    nifo_table_html,
    refusals_html,
    values_html,
    variance_html,
)
from identify.contacts.results import identified_rig
from identify.contacts.space_figures import space_figures
from identify.contacts.space_identification import SpaceIdentification
from identify.pages import page
from identify.pages.style import Picture
from rig.files import make_folder, write_bytes, write_json
from rig.model.description import to_json

_CAPTIONS = {
    "orbit": "The relative displacement in its ring, coloured by the contact force.",
    "radial": "The measured force across the wall, without assuming a law, over the radius, and the law found.",
    "ring_surface": "The force across the wall over radius and angle.",
    "friction": "The force along the wall over that across it, and the law found.",
    "nifo": "The stiffness over frequency by NIFO, of each direction in the modal equation in which it varies least. "
    "The values have no known error: each equation takes its mode of rig.json as right and does not see the others.",
    "kinds": "Free, sliding and sticking motion of a second; green: whirling, once around or more in touch.",
}


def write_space_results(
    result: SpaceIdentification, out: Path, title: str, laws: Laws, laws_name: str, sources: Sequence[Path] = ()
) -> None:
    """Write contact.html, the figures, the identified rig.json and, last of all, contact.json."""
    make_folder(out)
    figures = space_figures(result, laws, laws_name)
    for name, image in figures.items():
        image.save(out / f"{name}.png")
    _write_page(result, figures, title, (laws, laws_name), out / "contact.html", sources)
    write_bytes(to_json(identified_rig(result.rig, result.report)), out / "rig.json")
    write_json(result.report, out / "contact.json")


def _write_page(
    result: SpaceIdentification,
    figures: Mapping[str, Picture],
    title: str,
    laws_and_name: tuple[Laws, str],
    path: Path,
    sources: Sequence[Path],
) -> None:
    report = result.report
    findings = page.list_html(finding.sentence for finding in report.findings) if report.findings else ""
    folded_figures = {name: image for name, image in figures.items() if name != "orbit"}
    drawn_html = {name: page.figure(name, image, _CAPTIONS[name]) for name, image in folded_figures.items()}
    nifo_html = drawn_html.pop("nifo", "") + nifo_table_html(report)
    orbit_html = page.figure("orbit", figures["orbit"], _CAPTIONS["orbit"], page.FIRST_PLOT_PX) if figures else ""
    page.write(
        path,
        title=title,
        answer=answer(report, len(result.rig.contacts), *laws_and_name),
        top_blocks=[f"{findings}{drawing_html(result.rig, report)}{values_html(report, *laws_and_name)}", orbit_html],
        sections=[("What was refused", refusals_html(report))] if report.unanswered else [],
        folded_sections=[
            ("Does it fit?", "".join(drawn_html.values())),
            *([("How sure is it?", variance_html(_shares_by_quantity(result)))] if report.contacts else []),
            *([("For comparison: NIFO", nifo_html)] if report.nifo else []),
            ("What was assumed", page.list_html(_assumptions(result))),
        ],
        foot_text=FOOT_TEXT,
        sources=sources,
    )


def _shares_by_quantity(result: SpaceIdentification) -> dict[str, Mapping[str, float]]:
    """Shares of the variance of each quantity of the annular contacts by source."""
    quantities = {"clearance": CLEARANCE, "stiffness": STIFFNESS, "damping": DAMPING, "friction": FRICTION}
    return {
        f"{quantity} of {name}": {
            source: float(covariance[index, index] / estimate.covariance[index, index])
            for source, covariance in estimate.covariances.items()
        }
        for name, estimate in result.contacts.annular.items()
        for quantity, index in quantities.items()
    }


def _assumptions(result: SpaceIdentification) -> Iterator[str]:
    """Sentences on the law, the plane rigs, the tolerances, and the sensors and bands used."""
    yield (
        "The contact law of a ring: no force within the clearance; beyond it stiffness times depth plus damping times "
        "its rate, never pulling, and along the wall friction coefficient times that force times tanh of the sliding "
        "velocity over the sliding speed. The ring is round and equally stiff all around, and the bodies do not turn "
        "about their axes."
    )
    yield (
        "The bodies are those of rig.json, linear, and move in y and in z independently of each other but for the "
        "contacts: the forces of both directions are separated by themselves."
    )
    yield tolerances_sentence(result.tolerances)
    if result.tolerances.cross_axis:
        yield (
            "Where both directions are measured, each sensor shows a share of the motion across, fitted along: 0 +- "
            f"{100 * result.tolerances.cross_axis:.2g} % (standard deviation)."
        )
    motions = [separation.motion for separation in result.contacts.separations]
    for direction, motion in zip("yz", motions, strict=True):
        places = "; ".join(station_positions_text(body.name, motion.stations) for body in result.rig.bodies)
        yield f"Stations used in {direction}: {places}."
    low_hz, high_hz = result.report.trusted_hz
    yield (
        f"Frequencies: the motion is trusted from {low_hz:g} to {high_hz:.4g} Hz, the contact forces are separated "
        f"up to {result.rate_hz / 2 / result.decimation:.4g} Hz."
    )
    yield (
        "Accelerometers do not show what weight does to a rig at rest: the constant part of each contact force is that "
        "for which the open contact has none. The centre follows where the contact is closed at rest."
    )
    yield f"The accelerations' noise is taken from {result.report.noise_from}."
    yield from (f"{note[:1].upper()}{note[1:]}." for note in result.report.notes)
