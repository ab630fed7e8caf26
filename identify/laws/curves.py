"""The curves of the contact laws as tables."""

from collections.abc import Sequence

import numpy as np

from identify.laws.identification import FoundLaw
from identify.pages.tables import Table

PLACES = 800
"""At which the laws are told over the relative displacement."""


def curves(laws: Sequence[FoundLaw]) -> dict[str, Table]:
    """`law_over_time` (relative displacement, separated force, and the law's force, low-passed as that is) and, of
    every contact by its number, `law_N` (formula and straight pieces over relative displacement); none of no law."""
    tables = {f"law_{number}": _over_displacement(law) for number, law in enumerate(laws, start=1)}
    return tables | ({"law_over_time": _over_time(laws)} if laws else {})


def _over_time(laws: Sequence[FoundLaw]) -> Table:
    rows = min(law.record.force_n.size for law in laws)
    table: Table = {"time_s": laws[0].time_s[:rows]}
    for law in laws:
        name = law.result.contact
        table[f"{name} relative displacement m"] = law.record.at_force_m[:rows]
        table[f"{name} contact force N"] = law.record.force_n[:rows]
        table[f"{name} {law.drawn} N"] = law.drawn_n[:rows]
    return table


def _over_displacement(law: FoundLaw) -> Table:
    name, eta = law.result.contact, np.linspace(law.eta_m.min(), law.eta_m.max(), PLACES)
    return {
        f"{name} relative displacement m": eta,
        f"{name} formula N": law.formula(eta),
        f"{name} straight pieces N": law.pieces(eta),
    }
