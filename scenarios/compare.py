"""Recording and identification of the reference rigs, and tables of identified against true values."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from identify.contacts import Identification, identify_contact
from identify.contacts.report import write_results
from identify.contacts.results import ContactEstimate
from identify.pages.wording import COVERED, interval
from identify.signals.kinematics import MotionQuantity
from rig.commands.command_line import console_table, progress_bar, say
from rig.model.contact_laws import ContactLaw
from rig.recording import read, read_truth, truth_path
from rig.simulation.plants import plant_named
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle, BarrelCradleAnnular, Sdof

PLANE_QUANTITIES = {"clearance_m": ("clearance, mm", 1e3), "stiffness_n_per_m": ("stiffness, N/m", 1.0)}


@dataclass(frozen=True)
class Comparison:
    """An identification and the contact laws that made its recording, by contact."""

    identification: Identification
    true_laws: dict[str, ContactLaw]

    def print_estimates(self, title: str) -> None:
        """Print clearances and stiffnesses beside the true ones."""
        title = f"{title} (± 95 % with laboratory tolerances)"
        print_estimates(title, self.identification.report.contacts, self.true_laws)

    def print_answer(self, words: str, page_path: Path) -> None:
        """Print each clearance and stiffness with its interval beside the true one, the page, and what to try next."""
        print()
        say(f"The answer, {words}:")
        for contact in self.identification.report.contacts:
            law = self.true_laws[contact.name]
            clearance = interval(1e3 * contact.clearance_m.value, 1e3 * contact.clearance_m.standard_error, "mm")
            stiffness = interval(contact.stiffness_n_per_m.value, contact.stiffness_n_per_m.standard_error, "N/m")
            say(
                f"  {contact.name}: clearance {clearance} (true: {1e3 * law.clearance_m:g} mm), stiffness {stiffness} "
                f"(true: {law.stiffness_n_per_m:g} N/m)"
            )
        for unanswered in self.identification.report.unanswered:
            say(f"  {unanswered.name}: not told by this record: {unanswered.reason}")
        say(f"{page_path}: the page of this answer; open it in a browser")
        say("next: rig demo, which also changes a machine and names the change; then rig init, for a rig of your own")

    def print_nifo_forms(self, title: str, band_hz: tuple[float, float] = (0.0, np.inf)) -> None:
        """Print the errors of stiffness and FRF of the main equation, by NIFO in the paper's and in the weak form."""
        headings = ("form", "contact", "mean off by, %", "rms off by, %", "FRF squared error, %", "FRF rms error, %")
        table, identification = console_table(title, headings, 2), self.identification
        for form, nifo in (("the paper's", identification.paper_nifo), ("weak", identification.weak_nifo)):
            in_band = (nifo.frequency_hz >= band_hz[0]) & (nifo.frequency_hz <= band_hz[1])
            true_frf = nifo.nominal_frf()[in_band]
            frf_error_share = float(np.sum(np.abs(nifo.frf[in_band] - true_frf) ** 2) / np.sum(np.abs(true_frf) ** 2))
            for stiffness_row, contact_index in enumerate(nifo.contact_indices):
                contact_name = identification.rig.contacts[contact_index].name
                true_n_per_m = self.true_laws[contact_name].stiffness_n_per_m
                errors_percent = 100 * (nifo.stiffness_n_per_m[stiffness_row, in_band] / true_n_per_m - 1)
                table.add_row(
                    form,
                    contact_name,
                    f"{errors_percent.real.mean():+.4f}",
                    f"{np.sqrt(np.mean(np.abs(errors_percent) ** 2)):.4f}",
                    f"{100 * frf_error_share:.2g}",
                    f"{100 * np.sqrt(frf_error_share):.2g}",
                )
        Console().print(table)

    def print_by_equation(self, title: str) -> None:
        """Print the errors of NIFO's stiffness in every modal equation, and of the clearance by its surface."""
        headings = ("equation", "contact", "clearance off by, %", "stiffness off by, %", "rms spread, %", "")
        table = console_table(title, headings, 2)
        report = self.identification.report
        surfaces = {s.equation: {c.contact: c.clearance_m.value for c in s.clearances} for s in report.surface.surfaces}
        for equation_result in report.nifo:
            for stiffness in equation_result.stiffness:
                law = self.true_laws[stiffness.contact]
                clearance_m = surfaces[equation_result.equation].get(stiffness.contact)
                table.add_row(
                    equation_result.equation,
                    stiffness.contact,
                    "not determined" if clearance_m is None else f"{100 * (clearance_m / law.clearance_m - 1):+.4f}",
                    f"{100 * (stiffness.mean_n_per_m.value / law.stiffness_n_per_m - 1):+.4f}",
                    f"{100 * stiffness.rms_deviation_n_per_m / law.stiffness_n_per_m:.3f}",
                    "nearly invisible" if stiffness.contact in equation_result.nearly_invisible else "",
                )
        Console().print(table)


def record_reference_rig(settings: Sdof | BarrelCradle | BarrelCradleAnnular, plant_name: str, path: Path) -> Path:
    """Path of the recording of a reference rig by a plant, made with its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with progress_bar(f"recording {path.name} ({plant_name})") as progress:
        record(
            settings.rig(),
            settings.force(),
            plant=plant_named(plant_name),
            duration_s=settings.duration_s,
            step_s=settings.step_s,
            path=path,
            progress=progress,
        )
    return path


def identify_against_truth(path: Path, *, use: MotionQuantity, out: Path, equation: str | None = None) -> Comparison:
    """Identify a recording, take the true laws from its truth file, and write contact.json, page and figures."""
    with progress_bar(f"identifying {path.name} ({use})") as progress:
        identification = identify_contact(read(path), use=use, equation=equation, progress=progress)
        true_laws = {contact.name: contact.law for contact in read_truth(truth_path(path)).rig.contacts}
        write_results(identification, out, f"{identification.rig.name}: {path.name}, {use}", true_laws, "true")
    return Comparison(identification, true_laws)


def print_estimates(
    title: str,
    estimates: Sequence[ContactEstimate],
    true_laws: Mapping[str, ContactLaw],
    quantities: Mapping[str, tuple[str, float]] = PLANE_QUANTITIES,
) -> None:
    """Print estimates beside true values; quantities are those of a contact, by field, with name and unit factor."""
    table = console_table(title, ("contact", "quantity", "true", "identified", "± 95 %", "off by, %"), 2)
    for contact in estimates:
        for field, (quantity, unit_factor) in quantities.items():
            true, estimate = getattr(true_laws[contact.name], field), getattr(contact, field)
            if estimate is not None:
                values = (true, estimate.value, COVERED * estimate.standard_error)
                cells = (f"{unit_factor * x:.{digits}g}" for x, digits in zip(values, (6, 6, 2), strict=True))
                table.add_row(contact.name, quantity, *cells, f"{100 * (estimate.value / true - 1):+.4f}")
    Console().print(table)
