"""What the scenarios share: record, identify, and set what was identified beside what is true."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from identify.contacts import Identification, identify_contact
from identify.contacts.report import write_results
from identify.pages.wording import COVERED
from identify.signals.kinematics import Use
from rig.commands.command_line import progress_bar
from rig.model.contact_laws import ContactLaw
from rig.recording import read, read_truth, truth_path
from rig.simulation.plants import plant_named
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle, BarrelCradleAnnular, Sdof


@dataclass(frozen=True)
class Comparison:
    """An identification and the contact laws that made its recording, by contact."""

    found: Identification
    true: dict[str, ContactLaw]

    def errors_percent(self, contact: str) -> tuple[float, float]:
        """Of the clearance and the stiffness."""
        law = self.true[contact]
        estimate = next(c for c in self.found.report.contacts if c.name == contact)
        return (
            100 * (estimate.clearance_m.value / law.clearance_m - 1),
            100 * (estimate.stiffness_n_per_m.value / law.stiffness_n_per_m - 1),
        )


def recorded(settings: Sdof | BarrelCradle | BarrelCradleAnnular, plant: str, path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with progress_bar(f"recording {path.name} ({plant})") as progress:
        record(
            settings.rig(),
            settings.force(),
            plant=plant_named(plant),
            duration_s=settings.duration_s,
            step_s=settings.step_s,
            path=path,
            progress=progress,
        )
    return path


def identified_against_true(path: Path, *, use: Use, out: Path, equation: str | None = None) -> Comparison:
    """Identifies a recording, takes the true laws from its truth file, and writes contact.json, page and figures."""
    with progress_bar(f"identifying {path.name} ({use})") as progress:
        found = identify_contact(read(path), use=use, equation=equation, progress=progress)
        true = {c.name: c.law for c in read_truth(truth_path(path)).rig.contacts}
        write_results(found, out, f"{found.rig.name}: {path.name}, {use}", true, "true")
    return Comparison(found, true)


def shown(title: str, comparison: Comparison) -> None:
    """The table of identified against true; the standard errors allow for what a laboratory does not know exactly."""
    table = Table(title=f"{title} (± 95 % with laboratory tolerances)")
    for heading in ("contact", "quantity", "true", "identified", "± 95 %", "off by, %"):
        table.add_column(heading, justify="left" if heading in ("contact", "quantity") else "right")
    for estimate in comparison.found.report.contacts:
        law, errors = comparison.true[estimate.name], comparison.errors_percent(estimate.name)
        gap, stiffness = estimate.clearance_m, estimate.stiffness_n_per_m
        for name, true, value, reach, off in (
            ("clearance, mm", 1e3 * law.clearance_m, 1e3 * gap.value, 1e3 * COVERED * gap.standard_error, errors[0]),
            ("stiffness, N/m", law.stiffness_n_per_m, stiffness.value, COVERED * stiffness.standard_error, errors[1]),
        ):
            table.add_row(estimate.name, name, f"{true:.6g}", f"{value:.6g}", f"{reach:.2g}", f"{off:+.4f}")
    Console().print(table)


def forms_beside(comparison: Comparison, title: str, band_hz: tuple[float, float] = (0.0, np.inf)) -> None:
    """NIFO in the paper's form and in the weak form: stiffness and FRF of the main equation against the true ones."""
    table = Table(title=title)
    for heading in ("form", "contact", "mean off by, %", "rms off by, %", "FRF squared error, %", "FRF rms error, %"):
        table.add_column(heading, justify="left" if heading in ("form", "contact") else "right")
    for form, result in (("the paper's", comparison.found.paper), ("weak", comparison.found.weak)):
        inside = (result.frequency_hz >= band_hz[0]) & (result.frequency_hz <= band_hz[1])
        true = result.true_frf()[inside]
        squared = float(np.sum(np.abs(result.frf[inside] - true) ** 2) / np.sum(np.abs(true) ** 2))
        for i, j in enumerate(result.contacts):
            contact = comparison.found.rig.contacts[j].name
            off = 100 * (result.stiffness_n_per_m[i, inside] / comparison.true[contact].stiffness_n_per_m - 1)
            table.add_row(
                form,
                contact,
                f"{off.real.mean():+.4f}",
                f"{np.sqrt(np.mean(np.abs(off) ** 2)):.4f}",
                f"{100 * squared:.2g}",
                f"{100 * np.sqrt(squared):.2g}",
            )
    Console().print(table)


def equation_by_equation(comparison: Comparison, title: str) -> None:
    """NIFO's stiffness in every modal equation, and the clearance by its surface."""
    table = Table(title=title)
    for heading in ("equation", "contact", "clearance off by, %", "stiffness off by, %", "rms spread, %", ""):
        table.add_column(heading, justify="right" if "%" in heading else "left")
    report = comparison.found.report
    surfaces = {s.equation: {c.contact: c.clearance_m.value for c in s.clearances} for s in report.surface.surfaces}
    for each in report.nifo:
        for stiffness in each.stiffness:
            law = comparison.true[stiffness.contact]
            gap = surfaces[each.equation].get(stiffness.contact)
            table.add_row(
                each.equation,
                stiffness.contact,
                "not told" if gap is None else f"{100 * (gap / law.clearance_m - 1):+.4f}",
                f"{100 * (stiffness.mean_n_per_m.value / law.stiffness_n_per_m - 1):+.4f}",
                f"{100 * stiffness.rms_deviation_n_per_m / law.stiffness_n_per_m:.3f}",
                "nearly invisible" if stiffness.contact in each.nearly_invisible else "",
            )
    Console().print(table)
