"""What is exported is what the identification found, in every format."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from pyarrow import parquet
from scipy.io import loadmat

from identify.contacts.curves import curves
from identify.contacts.identification import identify_contact
from identify.pages.tables import WRITERS, save_tables
from tests.fuzz.readers import sound_recording


@pytest.fixture(scope="module")
def found():
    return identify_contact(sound_recording())


def read_back(path):
    if path.suffix == ".csv":
        names, *rows = csv.reader(path.read_text().splitlines())
        return names, np.array(rows, dtype=float).T
    if path.suffix == ".mat":
        file = loadmat(path, squeeze_me=True)
        return list(file["names"]), file["values"].T
    table = parquet.read_table(path)
    return table.column_names, np.array([column.to_numpy() for column in table.columns])


@pytest.mark.parametrize("form", WRITERS)
def test_every_curve_comes_back(found, tmp_path, form):
    save_tables(curves(found), tmp_path, form)
    for name, table in curves(found).items():
        names, rows = read_back(tmp_path / f"{name}.{form}")
        assert names == list(table)
        np.testing.assert_array_equal(rows, [*table.values()])
    assert len(list(tmp_path.iterdir())) == 3


def test_times_are_those_of_the_record(found):
    """Also where its beginning is left out, as it does not begin at rest."""
    later = replace(found, motion=found.motion.part(slice(100, None)))
    for table in ("motion", "surface"):
        assert curves(later)[table]["time_s"][0] == 100 / found.motion.sample_rate_hz


def test_the_curves_hold_the_law(found):
    """Beyond the stop the force follows the stiffness, within there is none: by least squares over the motion alone."""
    motion, (contact,) = curves(found)["motion"], found.report.contacts
    eta, force = motion["stop relative displacement m"], motion["stop contact force N"]
    beyond = np.abs(eta) - contact.clearance_m.value
    deep = beyond > 0.3 * beyond.max()
    stiffness = np.sum(np.abs(force[deep]) * beyond[deep]) / np.sum(beyond[deep] ** 2)
    assert stiffness == pytest.approx(contact.stiffness_n_per_m.value, rel=0.1)  # the force is low-passed
    assert np.std(force[beyond < -0.3 * contact.clearance_m.value]) < 0.15 * np.std(force[deep])
    nifo = curves(found)["nifo"]
    mean = nifo["weak form stop stiffness N/m real"].mean()
    assert mean == pytest.approx(found.report.nifo[0].stiffness[0].mean_n_per_m.value, rel=1e-9)
