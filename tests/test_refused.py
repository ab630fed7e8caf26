"""The table of what is refused, in identify/REFUSALS.md: every row is made, and its sentence read."""

import dataclasses
import re

import numpy as np
import pytest
from msgspec.structs import replace

import identify
from identify.contacts.refusals import ContactRefusedError
from rig.errors import RigError
from rig.lab.importing import import_file
from rig.model.contact_laws.dead_zone import symmetric_dead_zone
from rig.model.contact_laws.spring import Spring
from rig.model.description import ON_GROUND, BaseMotion, PointSpring, Sensor, to_json
from rig.recording import Recording, Signals, channel_groups
from rig.simulation.fmu import export_fmu
from rig.simulation.plants import ancf, modal
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle, BarrelCradleAnnular, Sdof
from tests.campaigns import laboratory_tests, topologies
from tests.readme_tables import ROOT
from tests.rig.lab.modal import test_uff as uff

RING = BarrelCradleAnnular(sensors="acceleration").rig()
HEAD = "| rig or test | refused by | code or sentence |"
SDOF, BEAMS = Sdof(sensors="acceleration").rig(), BarrelCradle(sensors="acceleration").rig()
TWO_FORCES = replace(SDOF, force_at=(SDOF.force_at, SDOF.force_at))
CHAIN = topologies.chain(2, "displacement", ground=True)
TABLE = Sensor(name="table", station=ON_GROUND, quantity="acceleration")
ON_TABLE = replace(SDOF, force_at=ON_GROUND, sensors=(TABLE, *SDOF.sensors))
SHAKEN = BaseMotion(acceleration_rms_m_per_s2=1.0, low_hz=1.0, high_hz=15.0)


def rows():
    text = (ROOT / "identify" / "REFUSALS.md").read_text(encoding="utf-8")
    lines = text.partition(HEAD)[2].partition("\n\n")[0].splitlines()[2:]
    return {name: sentence for name, _, sentence in (line.strip("| ").split(" | ") for line in lines)}


def noise(rig, seconds=12.0, forced=True, seed=1):
    """A recording of noise: what is refused at once is refused whatever it holds."""
    rng, samples = np.random.default_rng(seed), round(seconds * rig.sample_rate_hz)
    signals = {
        name: Signals(channels, 0.0, rng.standard_normal((len(channels.names), samples)))
        for name, channels in channel_groups(rig).items()
    }
    if not forced:
        signals["force"] = Signals(signals["force"].channels, 0.0, np.zeros((1, samples)))
    return Recording(rig, signals, {})


def contact(rig, **given):
    return lambda _: identify.contact(noise(rig, **given))


def gap(rig, **given):
    return lambda _: identify.gap([noise(rig, **given), noise(rig, **given, seed=2)])


def laboratory(name):
    """A test of `tests.campaigns.laboratory_tests`."""
    return lambda folder: identify.contact(
        laboratory_tests.recorded(laboratory_tests.REFUSED[name], folder / "r.mcap", duration_s=14.0)
    )


def stops(believed, true, rms_n=12.0):
    """Of two stops on one mass, what is said of the last one that is not told."""

    def run(folder):
        rig, actual = (topologies.progressive_stop("displacement", *laws) for laws in (believed, true))
        case = topologies.Topology(rig, rms_n, "")
        last_refusal(case, actual, folder)

    return run


def last_refusal(case, actual, folder):
    """Raise the refusal of the last contact of a topology that is refused."""
    path = topologies.recorded(case, folder / "r.mcap", duration_s=12.0, actual=actual)
    *_, last = identify.contact(path).identification.outcomes.refusals.values()
    raise ContactRefusedError(last)


def spring_beside(rig, springs):
    """Springs between the places of the rig's first contact, of which none is told."""
    struts = [replace(rig.contacts[0], name=f"strut {k}", law=Spring(stiffness_n_per_m=2e4)) for k in range(springs)]
    case = topologies.Topology(replace(rig, contacts=(*rig.contacts, *struts)), 12.0, "")
    return lambda folder: last_refusal(case, None, folder)


def spring_as_stop():
    """A spring that rig.json describes as a dead zone without clearance."""
    rig = topologies.one_mass(0.0)
    spring = replace(rig.contacts[0], law=Spring(stiffness_n_per_m=2e4, damping_n_s_per_m=10.0))
    return lambda folder: last_refusal(topologies.Topology(rig, 12.0, ""), replace(rig, contacts=(spring,)), folder)


def laboratory_gap(test, **given):
    """A test of `tests.campaigns.laboratory_tests` whose force channel is zero, diagnosed."""

    def run(folder):
        recorded = laboratory_tests.recorded(dataclasses.replace(test, **given), folder / "r.mcap", duration_s=26.0)
        recorded.signals["force"].values[:] = 0.0
        identify.gap(recorded)

    return run


def imported(text):
    def run(folder):
        (folder / "rig.json").write_bytes(to_json(SDOF))
        (folder / "map.toml").write_text(text)
        names = f"t,F,{SDOF.sensors[0].name}"
        times = [k / SDOF.sample_rate_hz + 0.1 * (k > 50) for k in range(100)]
        (folder / "r.csv").write_text(names + "\n" + "".join(f"{t},1,1\n" for t in times))
        import_file(folder / "r.csv", folder / "map.toml", folder / "r.mcap")

    return run


def simulated(rig, plant):
    return lambda folder: record(
        rig,
        BarrelCradle().force(),
        plant=plant,
        duration_s=2.0,
        step_s=2.0**-13,
        path=folder / "r.mcap",
        progress=lambda _: None,
    )


CASES = {name: laboratory(name) for name in laboratory_tests.REFUSED} | {
    "no contact": contact(replace(SDOF, contacts=())),
    "dampers, loads, tones, cubic springs in rig.json": contact(
        replace(SDOF, springs=(PointSpring(station=SDOF.force_at, cubic_n_per_m3=1e9),))
    ),
    "a ring with sensors in one direction": contact(replace(RING, sensors=RING.sensors[: len(RING.sensors) // 2])),
    "weight on a stop of one direction": contact(replace(BEAMS, gravity_m_per_s2=9.81)),
    "weight on a stop of one direction beside a ring": contact(
        replace(RING, contacts=(replace(RING.contacts[0], law=symmetric_dead_zone(2e-3, 5e5)), RING.contacts[1]))
    ),
    "three contacts of two masses": contact(
        replace(CHAIN, contacts=(*CHAIN.contacts, replace(CHAIN.contacts[1], name="wall", at=CHAIN.contacts[0].at)))
    ),
    "two stops on one mass that are believed alike": stops(((7e-4, 3e4), (6.5e-4, 3e4)), ((5e-4, 8e3), (1e-3, 1e5))),
    "two stops on one mass whose knees coincide": stops(((5e-4, 8e3), (1e-3, 1e5)), ((7e-4, 8e3), (7e-4, 5e4))),
    "a stop behind another that is not reached": stops(((2e-4, 8e3), (5e-3, 1e5)), ((2e-4, 8e3), (5e-3, 1e5)), 4.0),
    "two springs between the same places": spring_beside(topologies.one_mass(4e-4), springs=2),
    "a spring that is described as a stop without clearance": spring_as_stop(),
    "strain gauges alone": contact(BarrelCradle(sensors="strain").rig()),
    "a record of 4 s": contact(BEAMS, seconds=4.0),
    "two beams, force not recorded, diagnosed": gap(BarrelCradle(sensors="displacement").rig(), forced=False),
    "one mass, force not recorded, diagnosed": laboratory_gap(laboratory_tests.REFUSED["one mass, force not recorded"]),
    "one mass, a blow that is not recorded, diagnosed": laboratory_gap(
        laboratory_tests.TESTS["one mass, free decay, no force measured"], without_s=0.0
    ),
    "one mass, base excitation not recorded, diagnosed": laboratory_gap(
        laboratory_tests.TESTS["one mass, base excitation, displacement"]
    ),
    "strain gauges alone, diagnosed": gap(BarrelCradle(sensors="strain").rig()),
    "a record of 4 s, diagnosed": gap(SDOF, seconds=4.0),
    "base motion of held beams in rig.json, diagnosed": gap(replace(BEAMS, base_motion=SHAKEN)),
    "a force beside a measured base, diagnosed": gap(replace(ON_TABLE, force_at=SDOF.force_at)),
    "a base measured by its velocity, diagnosed": gap(
        replace(ON_TABLE, sensors=(replace(TABLE, quantity="velocity"), *SDOF.sensors))
    ),
    "the level of a force where the base shakes, planned": lambda _: identify.plan(ON_TABLE, force_rms_n=1.0),
    "a base at rest and no force": simulated(ON_TABLE, modal.simulate),
    "two forces at once, as an FMU": lambda folder: export_fmu(TWO_FORCES, folder / "r.fmu"),
    "two forces in the map, one in rig.json": imported(
        f'force = [{{ column = "F" }}, {{ column = "G" }}]\n[sensors]\n{SDOF.sensors[0].name} = {{ column = "a" }}\n'
    ),
    "time stamps with a gap": imported(
        'time = { column = "t" }\nforce = { column = "F", unit = "N" }\n[sensors]\n'
        f'{SDOF.sensors[0].name} = {{ column = 3, unit = "m/s^2" }}\n'
    ),
    "a modal basis on the plant ancf": simulated(topologies.frame(0.0), ancf.simulate),
    "a shaken modal basis that is held": lambda _: replace(topologies.frame(3.0), base_motion=SHAKEN),
    "FRFs without a driving point": lambda folder: uff.read(folder, [uff.nodes(), *uff.FRFS[:9]]),
    "mode shapes without modal masses": lambda folder: uff.read(
        folder, [uff.nodes(), *(one | {"modal_m": 0.0} for one in uff.normal_modes())]
    ),
}


STUDIES = (
    "two beams, a blow that is not recorded",
    "two beams, base excitation",
    "two stops on one mass that are believed alike",
)
"""Cases of a quarter of a minute, whose codes other cases have too."""


def test_the_table_has_a_row_a_case():
    assert list(rows()) == list(CASES)


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.study if n in STUDIES else ()) for n in CASES])
def test_the_refusal_is_the_one_of_the_table(name, tmp_path):
    """By code, or by a sentence in which … stands for a path, or for numbers of the record."""
    with pytest.raises(RigError) as refused:
        CASES[name](tmp_path)
    said = str(refused.value)
    assert "\n" not in said
    if rows()[name].startswith("`"):
        assert f"`{refused.value.refusal.code}`" == rows()[name]
        return
    assert re.search(r".*?".join(map(re.escape, rows()[name].split("…"))), said), said
