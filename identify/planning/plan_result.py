"""Result of `identify.plan`: as text, dictionary, rows of a table, and files."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from identify.pages.summary import Summarized, Summary
from identify.pages.wording import COVERED
from identify.planning import page
from identify.planning.results import PlanReport
from rig.files import make_folder, write_json
from rig.model.description import Rig


@dataclass(frozen=True)
class PlanResult(Summarized):
    """Plan of a test: what it will tell of every contact, and what would shorten the intervals."""

    report: PlanReport
    """Expected standard errors, ranked changes and sensors: the contents of plan.json."""
    rig: Rig = field(repr=False)
    """Rig that was planned with."""
    sources: tuple[Path, ...] = ()
    """File of the rig or recording."""

    def to_dict(self) -> dict[str, Any]:
        """Dictionary as in plan.json."""
        return dict(msgspec.to_builtins(self.report))

    def table(self) -> list[dict[str, str | float]]:
        """Row of each contact: believed values, and half their expected 95 % intervals."""
        rows: list[dict[str, str | float]] = []
        for contact in self.report.contacts:
            row: dict[str, str | float] = {"contact": contact.name}
            for quantity_name, quantity in contact.quantities.items():
                row[quantity_name], row[f"{quantity_name}_within"] = quantity.value, COVERED * quantity.standard_error
            rows.append(row)
        return rows

    def save(self, folder: str | Path) -> None:
        """Write plan.html, a self-contained page, and plan.json."""
        folder_path = Path(folder)
        make_folder(folder_path)
        page.write_page(self.report, self.rig, folder_path / "plan.html", self.sources)
        write_json(self.report, folder_path / "plan.json")

    def summary(self) -> Summary:
        """Sentence on what the test will tell and what helps most, and the expected interval of each contact."""
        contact_rows = tuple(dict(zip(page.CONTACT_HEAD, row, strict=True)) for row in page.contact_rows(self.report))
        below = (*page.annular_contact_sentences(self.report), *self.report.notes)
        return Summary(contact_rows, above=(page.sentence(self.report),), below=below)
