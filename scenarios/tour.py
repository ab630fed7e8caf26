"""A tour, to be read from top to bottom: describe a rig, record it, identify it, let it differ from its description,
find out how, and correct the description.

python -m scenarios.tour --out out/tour
"""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from identify.contacts import identify_contact
from identify.gaps.decision.answer import diagnose
from identify.gaps.decision.prepare import simulator_named
from identify.pages.wording import interval
from rig.commands.command_line import progress_bar, run
from rig.effects.added_mass import AddedMass
from rig.files import write_bytes
from rig.model.contact_laws import DeadZone
from rig.model.description import Contact, Rig, Sensor, Station, to_json
from rig.model.oscillator import Oscillator
from rig.recording import Recording, read
from rig.simulation.excitation import BandLimitedGaussian
from rig.simulation.plants import modal
from rig.simulation.record import record

app = typer.Typer(pretty_exceptions_enable=False)


@app.command()
def tour(
    out: Annotated[Path, typer.Option(help="Folder for the recordings and the corrected rig.json.")] = Path("out/tour"),
    duration: Annotated[float, typer.Option(help="Length of each recording, s.")] = 60.0,
) -> None:
    """Describe a rig, record it, diagnose it and correct its description, in seven steps."""
    out.mkdir(parents=True, exist_ok=True)

    # 1. Describe. A rig is a value: bodies, contacts, where the force acts, and the sensors. This one is a mass of 1 kg
    #    on a spring that would swing at 5 Hz, between two stops, each 1 mm away and as stiff as 10 N/mm. One
    #    accelerometer sits on the mass, with the noise of a good one.
    mass = Station("mass")
    rig = Rig(
        name="tour",
        bodies=(Oscillator(name="mass", mass_kg=1.0, frequency_hz=5.0, damping_ratio=0.01),),
        contacts=(
            Contact(
                name="stop",
                at=mass,
                against=None,  # the ground
                law=DeadZone(lower_clearance_m=1e-3, upper_clearance_m=1e-3, stiffness_n_per_m=1e4),
            ),
        ),
        force_at=mass,
        sensors=(Sensor(name="accelerometer", station=mass, quantity="acceleration", noise_density=1e-3),),
        sample_rate_hz=512.0,
    )
    print(f"1. rig {rig.name!r}: {len(rig.bodies)} body, {len(rig.contacts)} contact, {len(rig.sensors)} sensor")

    # 2. Record. A shaker pushes the mass with a random force of 0 to 15 Hz; the file is what a laboratory would have,
    #    with rig.json inside.
    recording = record_actual_rig(rig, rig, out / "first.mcap", duration, rms_n=0.5, seed=1)
    print(f"2. {out / 'first.mcap'}: {recording.duration_s:g} s at {recording.rig.sample_rate_hz:g} Hz")

    # 3. Look at a channel. A group holds all channels of one quantity, in SI, one row a channel.
    acceleration = recording.signals["acceleration"]
    values = acceleration.values[0]
    peak_sample = int(np.argmax(np.abs(values)))
    print(
        f"3. {acceleration.channels.names[0]}: {np.sqrt(np.mean(values**2)):.3g} {acceleration.channels.unit} rms, "
        f"largest {values[peak_sample]:.3g} at {acceleration.time_s[peak_sample]:.3f} s, where the mass hits a stop"
    )

    # 4. Identify. From the force and the acceleration alone: how large is the clearance, how stiff are the stops?
    with progress_bar("identifying") as progress:
        (contact,) = identify_contact(recording, progress=progress).report.contacts
    clearance, stiffness = contact.clearance_m, contact.stiffness_n_per_m
    print(f"4. clearance {interval(1e3 * clearance.value, 1e3 * clearance.standard_error, 'mm')} (95 %), true is 1 mm")
    print(f"   stiffness {interval(stiffness.value, stiffness.standard_error, 'N/m')}, true is 10000 N/m")

    # 5. Change it. An effect is a function from rig to rig: here 50 g of cable and bracket hang on the mass that
    #    nobody counted. The recordings still carry the rig that is believed.
    actual = AddedMass(mass_kg=0.05).applied_to(rig)
    search_record = record_actual_rig(rig, actual, out / "monday.mcap", duration, rms_n=0.5, seed=2)
    validation_record = record_actual_rig(rig, actual, out / "tuesday.mcap", duration, rms_n=0.7, seed=3)
    print(f"5. {1e3 * actual.masses[0].mass_kg:g} g more than believed; two recordings of that were made")

    # 6. Diagnose. What in Monday's recording does the believed rig not explain, and which effect of the library would?
    #    Tuesday's, at another level of force, decides between the explanations. What is normal is simulated first,
    #    and kept in a file.
    with progress_bar("diagnosing") as progress:
        simulator = simulator_named("modal")
        diagnosis, corrected = diagnose(
            search_record, validation_record, simulator, out / "null_reference.json", lambda _, done: progress(done)
        )
    print(f"6. {diagnosis.sentence}")

    # 7. Correct. The diagnosis gives the rig with the effect in it, ready to be believed from now on.
    write_bytes(to_json(corrected), out / "rig.json")
    added_kg = sum(mass.mass_kg for mass in corrected.masses)
    print(f"7. corrected by {1e3 * added_kg:.1f} g, in {out / 'rig.json'}")


def record_actual_rig(believed: Rig, actual: Rig, path: Path, duration_s: float, rms_n: float, seed: int) -> Recording:
    """Recording of the actual rig, whose file states the believed one, as a laboratory would have it."""
    force = BandLimitedGaussian(rms_n=rms_n, low_hz=0.0, high_hz=15.0, seed=seed)
    with progress_bar(f"recording {path.name}") as progress:
        record(
            believed,
            force,
            plant=modal.simulate,
            duration_s=duration_s,
            step_s=2.0**-13,
            path=path,
            progress=progress,
            actual=actual,
        )
    return read(path)


if __name__ == "__main__":
    run(app, "scenarios.tour")
